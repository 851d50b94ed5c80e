"""The teaching session as a state machine: every refusal and every way on."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
import errno
import os
from pathlib import Path
from typing import Any

from humanopts_env.domains.registry import make_domain
from humanopts_env.game import Moment, Source
from humanopts_learner.demonstrations import Demonstration, Kind
from humanopts_teach.demos.entries import Entry
from humanopts_teach.demos.store import DemonstrationStore
from humanopts_teach.dialogue.answers import Answer, Phase, Progress, Status, Verdict
from humanopts_teach.dialogue.lesson import Lesson, LessonRules
import numpy as np
import pytest

TAXI = make_domain('taxi')
OPTION = 'go to passenger and pickup'
CHOSEN = ('taxi_row', 'taxi_col', 'passenger_row', 'passenger_col')
START = 'taxi 0,1 passenger R destination G'
OTHER = 'taxi 3,1 passenger B destination R'


class Starts:
    """Start states without a learner: what is learned is set by the test."""

    def __init__(self) -> None:
        self.known: set[str] | None = None  # uuids counted in; None: all
        self.more = False  # the strategy has something left to ask

    def choose(
        self,
        participant: str,
        option_name: str,
        demonstrations: Sequence[Demonstration],
        rng: np.random.Generator,
    ) -> Any:
        return TAXI.sample_states(rng, 1)[0]

    def knows(self, demonstration: Demonstration) -> bool:
        return self.known is None or (demonstration.uuid in self.known) != demonstration.withdrawn

    def exhausted(
        self,
        participant: str,
        option_name: str,
        demonstrations: Sequence[Demonstration],
        rng: np.random.Generator,
    ) -> bool:
        return not self.more


class Table:
    """A lesson with the person, the game and the learner in the hands of the test."""

    def __init__(self, store: DemonstrationStore, *, budget: int = 5, seed: int = 0) -> None:
        self.store = store
        self.starts = Starts()
        self.time = 100.0
        self.episode = 0
        self.here: Moment | None = None
        self.lesson = Lesson(
            TAXI,
            store,
            self.starts,
            LessonRules('random', budget, seed),
            clock=lambda: self.time,
            today=lambda: '20260102',
        )

    def opened(self) -> 'Table':
        assert self.lesson.open_session('p1', 's1').ok
        return self

    def defined(self) -> 'Table':
        self.opened()
        assert self.lesson.define_option(OPTION).ok
        return self

    def answer_all(self, chosen: Sequence[str] = CHOSEN) -> Answer:
        for feature in TAXI.features:
            view = self.lesson.view
            assert view.question_feature == feature.name
            answer = self.lesson.answer_question(view.question_id, feature.name in chosen)
        return answer

    def ready(self) -> 'Table':
        self.defined()
        assert self.answer_all().ok
        return self

    def began(self, start_state: str = '') -> 'Table':
        prepared = self.lesson.prepare(start_state)
        assert prepared.ok, prepared
        self.episode += 1
        self.arrives(prepared.state)
        assert self.lesson.began(self.episode, prepared.state).ok
        return self

    def arrives(self, state: str) -> bool:
        """Let the game's first state of an episode arrive."""
        features = tuple(TAXI.feature_values(TAXI.decode(state)).tolist())
        self.here = Moment(self.episode, 0, state, features)
        return self.lesson.saw(self.here)

    def drive(self, *actions: str, source: Source = Source.PERSON) -> 'Table':
        for name in actions:
            assert self.here is not None
            action = [a.name for a in TAXI.actions].index(name)
            out = TAXI.step(TAXI.decode(self.here.state), action, np.random.default_rng(0))
            self.here = Moment(
                self.here.episode,
                self.here.step + 1,
                TAXI.encode(out.state),
                tuple(TAXI.feature_values(out.state).tolist()),
                previous_action=name,
                action_source=source,
                reward=out.reward,
                terminated=out.terminated,
            )
            self.lesson.saw(self.here)
        return self

    def end(self, verdict: Verdict | None = Verdict.DONE, again: bool = False) -> Answer:
        assert self.here is not None
        return self.lesson.end_demonstration(verdict, self.here.episode, self.here.step, again)

    def learned(self, *, met: bool = False, features: tuple[str, ...] = CHOSEN) -> None:
        self.lesson.learner_said(
            [Progress('p1', OPTION, features, self.lesson.awaited or 'old', met)]
        )

    def shown(self) -> 'Table':
        """Give one demonstration, learned from."""
        self.began().drive('west')
        assert self.end().ok
        self.learned()
        return self


@pytest.fixture
def store(tmp_path: Path) -> Iterator[DemonstrationStore]:
    with DemonstrationStore(tmp_path) as opened:
        yield opened


@pytest.fixture
def table(store: DemonstrationStore) -> Table:
    return Table(store)


def preparing(table: Table) -> Table:
    assert table.ready().lesson.prepare().ok
    return table


def learning(table: Table) -> Table:
    assert table.ready().began().drive('west').end().ok
    return table


def met(table: Table) -> Table:
    learning(table).learned(met=True)
    return table


def spent(table: Table) -> Table:
    table.ready()
    for _ in range(5):
        table.shown()
    return table


TO_PHASE: dict[Phase, Callable[[Table], Table]] = {
    Phase.NO_SESSION: lambda table: table,
    Phase.NO_OPTION: Table.opened,
    Phase.ASKING: Table.defined,
    Phase.READY: Table.ready,
    Phase.DEMONSTRATING: lambda table: table.ready().began(),
    Phase.LEARNING: learning,
    Phase.FINISHED: met,
}
# What each request answers in each phase.
TABLE = [
    ('open_session', dict.fromkeys(Phase, Status.OK) | {Phase.DEMONSTRATING: Status.WRONG_PHASE}),
    (
        'define_option',
        dict.fromkeys(Phase, Status.OK)
        | dict.fromkeys((Phase.NO_SESSION, Phase.DEMONSTRATING), Status.WRONG_PHASE),
    ),
    ('answer_question', dict.fromkeys(Phase, Status.NOT_ASKED) | {Phase.ASKING: Status.OK}),
    ('prepare', dict.fromkeys(Phase, Status.WRONG_PHASE) | {Phase.READY: Status.OK}),
    (
        'withdraw',
        dict.fromkeys(Phase, Status.WRONG_PHASE)
        | dict.fromkeys((Phase.ASKING, Phase.READY), Status.NO_DEMONSTRATION)
        | dict.fromkeys((Phase.LEARNING, Phase.FINISHED), Status.OK),
    ),
    ('end', dict.fromkeys(Phase, Status.WRONG_PHASE) | {Phase.DEMONSTRATING: Status.NO_STEPS}),
]
REQUESTS: dict[str, Callable[[Table], Answer]] = {
    'open_session': lambda table: table.lesson.open_session('p2', ''),
    'define_option': lambda table: table.lesson.define_option('another'),
    'answer_question': lambda table: table.lesson.answer_question(1, True),
    'prepare': lambda table: table.lesson.prepare(),
    'withdraw': lambda table: table.lesson.withdraw(),
    'end': lambda table: table.lesson.end_demonstration(Verdict.DONE, 1, 0, False),
}


@pytest.mark.parametrize('phase', Phase, ids=lambda phase: phase.name)
@pytest.mark.parametrize(('request_name', 'statuses'), TABLE)
def test_every_request_is_answered_in_every_phase(
    table: Table, phase: Phase, request_name: str, statuses: dict[Phase, Status]
) -> None:
    TO_PHASE[phase](table)
    assert table.lesson.phase is phase
    answer = REQUESTS[request_name](table)
    assert answer.status is statuses[phase]
    assert answer.detail
    if not answer.ok:
        assert table.lesson.phase is phase


FULL = 'recording stopped: the disk is full'
NEW_THINGS = ['open_session', 'define_option', 'answer_question', 'prepare', 'withdraw']


@pytest.mark.parametrize('phase', Phase, ids=lambda phase: phase.name)
@pytest.mark.parametrize('name', NEW_THINGS)
def test_while_it_is_paused_nothing_new_begins_and_then_all_goes_on(
    table: Table, phase: Phase, name: str
) -> None:
    view = TO_PHASE[phase](table).lesson.view
    table.lesson.pause(FULL)
    answer = REQUESTS[name](table)
    assert (answer.status, answer.detail) == (Status.PAUSED, f'the lesson is paused: {FULL}')
    paused = table.lesson.view
    assert (paused.phase, paused.paused) == (phase, FULL)
    assert paused.text
    table.lesson.pause('')
    assert table.lesson.view == view
    assert REQUESTS[name](table).status is dict(TABLE)[name][phase]


def test_a_demonstration_under_way_is_kept_while_paused_and_said_to_be_unrecorded(
    table: Table,
) -> None:
    table.ready().began(START).drive('west')
    table.lesson.pause(FULL)
    assert table.drive('west').end(Verdict.NOT_HERE).status is Status.STEPS_TAKEN
    answer = table.end()
    assert answer.ok
    assert 'not in this recording: the next one has it' in answer.detail
    assert 'not in this recording: the next one has it' in table.lesson.view.text
    table.learned()
    assert (table.lesson.phase, table.lesson.view.n_demonstrations) == (Phase.READY, 1)
    assert 'The lesson is paused.' in table.lesson.view.text
    assert table.lesson.demonstrations() == [answer.demonstration]


def test_a_demonstration_under_way_can_be_discarded_while_paused(table: Table) -> None:
    table.ready().began(START).drive('west')
    table.lesson.pause(FULL)
    assert table.end(Verdict.DISCARD).ok
    table.lesson.pause('')
    assert table.lesson.prepare().state == START


def test_an_episode_that_begins_after_the_pause_is_no_demonstration(table: Table) -> None:
    table.ready().lesson.prepare(START)
    table.lesson.pause(FULL)
    assert table.lesson.began(1, START).status is Status.PAUSED
    assert table.lesson.phase is Phase.READY
    table.lesson.pause('')
    assert table.lesson.prepare().ok


@pytest.mark.parametrize('phase', Phase, ids=lambda phase: phase.name)
def test_every_phase_says_what_comes_next(table: Table, phase: Phase) -> None:
    view = TO_PHASE[phase](table).lesson.view
    assert view.phase is phase
    assert view.text


@pytest.mark.parametrize('name', NEW_THINGS)
def test_nothing_comes_between_the_request_for_an_episode_and_its_start(
    table: Table, name: str
) -> None:
    answer = REQUESTS[name](preparing(table))
    assert answer.status in (Status.WRONG_PHASE, Status.NOT_ASKED)


@pytest.mark.parametrize(
    ('participant', 'session'), [('', 's1'), ('a b', ''), ('../x', ''), ('p1', 's/1')]
)
def test_a_session_needs_codes(table: Table, participant: str, session: str) -> None:
    assert table.lesson.open_session(participant, session).status is Status.BAD_NAME
    assert table.lesson.phase is Phase.NO_SESSION


def test_a_new_session_is_named_after_the_day_and_counted(table: Table) -> None:
    assert table.lesson.open_session('p1', '').session == '20260102-1'
    assert table.lesson.open_session('p1', '').session == '20260102-2'
    assert table.lesson.open_session('p2', '').session == '20260102-1'


@pytest.mark.parametrize(
    'name', ['', '   ', 'x' * 61, 'two\nlines', 'bell\a', 'action:north', '\u200b']
)
def test_an_option_needs_a_name_that_can_be_shown(table: Table, name: str) -> None:
    assert table.opened().lesson.define_option(name).status is Status.BAD_NAME
    assert table.lesson.phase is Phase.NO_OPTION


def test_one_question_is_asked_for_each_feature_in_the_words_of_the_paper(table: Table) -> None:
    view = table.defined().lesson.view
    assert view.question == f"Does the '{OPTION}' option depend on {TAXI.features[0].question}?"
    assert (view.question_id, view.questions_total) == (1, len(TAXI.features))
    table.answer_all()
    assert table.lesson.view.chosen_features == CHOSEN
    assert table.lesson.view.question_id == 0


def test_an_answer_to_another_question_changes_nothing(table: Table) -> None:
    table.defined().lesson.answer_question(1, True)
    again = table.lesson.answer_question(1, True)
    assert again.status is Status.NOT_ASKED
    assert 'question 2 is' in again.detail
    assert table.lesson.view.question_id == 2


def test_the_questions_are_asked_again_when_all_answers_are_no(table: Table) -> None:
    assert table.defined().answer_all(()).status is Status.NO_FEATURE
    view = table.lesson.view
    assert view.phase is Phase.ASKING
    assert (view.question_feature, view.question_id) == (TAXI.features[0].name, 11)
    assert 'no' in view.text
    assert table.answer_all().ok


def test_asking_again_forgets_the_answers_and_keeps_the_demonstrations(table: Table) -> None:
    met(table)
    answer = table.lesson.define_option(OPTION, ask_again=True)
    assert (answer.status, answer.resumed) == (Status.OK, True)
    assert table.lesson.phase is Phase.ASKING
    assert table.lesson.view.n_demonstrations == 1
    table.answer_all(CHOSEN[:2])
    assert table.lesson.phase is Phase.READY  # the criteria held on other features
    assert not table.lesson.criteria_met


def test_a_demonstration_holds_what_was_shown(table: Table) -> None:
    table.ready().began(START)
    table.time += 2.5
    table.drive('west', 'west', 'pickup')
    kept = table.end(again=True).demonstration
    assert kept is not None
    assert kept.kind is Kind.TRAJECTORY
    assert kept.states[0] == START
    assert len(kept.states) == len(kept.features) == 4
    assert kept.actions == ('west', 'west', 'pickup')
    assert kept.rewards == (-1.0, -1.0, 0.0)
    assert (kept.participant, kept.session, kept.option_name) == ('p1', 's1', OPTION)
    assert (kept.number, kept.chosen_features) == (1, CHOSEN)
    assert (kept.can_start_at_end, kept.terminated, kept.seconds) == (True, False, 2.5)
    assert table.lesson.demonstrations() == [kept]
    assert table.lesson.view.n_demonstrations == 1


def test_not_here_is_one_state_without_steps(table: Table) -> None:
    kept = table.ready().began(START).end(Verdict.NOT_HERE, again=True).demonstration
    assert kept is not None
    assert (kept.kind, kept.states, kept.actions) == (Kind.NOT_HERE, (START,), ())
    assert not kept.can_start_at_end
    assert table.lesson.view.n_not_here == 1


@pytest.mark.parametrize(
    ('steps', 'verdict', 'status'),
    [
        ((), Verdict.DONE, Status.NO_STEPS),
        (('west',), Verdict.NOT_HERE, Status.STEPS_TAKEN),
        (('west',), None, Status.BAD_VERDICT),
    ],
)
def test_a_verdict_that_does_not_fit_lets_the_demonstration_go_on(
    table: Table, steps: tuple[str, ...], verdict: Verdict | None, status: Status
) -> None:
    table.ready().began(START).drive(*steps)
    assert table.end(verdict).status is status
    assert table.drive('west', 'west', 'pickup').end().ok


@pytest.mark.parametrize(('episode', 'step'), [(1, 0), (1, 2), (2, 1), (0, 1)])
def test_a_verdict_on_another_state_is_not_carried_out(
    table: Table, episode: int, step: int
) -> None:
    table.ready().began(START).drive('west')
    answer = table.lesson.end_demonstration(Verdict.DONE, episode, step, False)
    assert answer.status is Status.NOT_CURRENT
    assert 'episode 1 step 1' in answer.detail
    assert table.end().ok


def test_the_state_that_a_verdict_names_may_still_be_on_its_way(table: Table) -> None:
    table.ready().began(START)
    assert table.lesson.reached(1, 0)
    assert not table.lesson.reached(1, 1)
    table.drive('west')
    assert table.lesson.reached(1, 1)


def test_a_discarded_demonstration_can_be_tried_again_from_the_same_state(table: Table) -> None:
    first = table.ready().began().lesson.view.start_state
    table.drive('west')
    assert table.lesson.end_demonstration(Verdict.DISCARD, 0, 0, False).ok
    view = table.lesson.view
    assert (view.phase, view.n_demonstrations, view.episode) == (Phase.READY, 0, 0)
    assert table.began().lesson.view.start_state == first


def test_a_start_state_that_was_asked_for_is_tried_again_too(table: Table) -> None:
    table.ready().began(START).end(Verdict.DISCARD)
    assert table.began().lesson.view.start_state == START


def test_start_states_depend_on_seed_person_option_and_number_alone(
    store: DemonstrationStore,
) -> None:
    first = Table(store, seed=3).ready()
    drawn = [first.began().lesson.view.start_state]
    first.drive('north')
    first.end()
    first.learned()
    drawn.append(first.began().lesson.view.start_state)
    resumed = Table(store, seed=3).opened()
    assert resumed.began().lesson.view.start_state == drawn[1] != drawn[0]
    other = Table(store, seed=4).opened()
    assert other.began().lesson.view.start_state != drawn[1]


@pytest.mark.parametrize(
    ('text', 'says'),
    [
        ('nowhere', 'nowhere'),
        ('taxi 9,9 passenger R destination G', '5 x 5'),
        ('taxi 0,0 passenger R destination R', 'over'),
    ],
)
def test_a_start_state_must_be_one_to_demonstrate_from(table: Table, text: str, says: str) -> None:
    answer = table.ready().lesson.prepare(text)
    assert answer.status is Status.BAD_STATE
    assert says in answer.detail
    assert table.lesson.prepare().ok


def test_a_game_that_does_not_answer_leaves_the_lesson_ready(table: Table) -> None:
    preparing(table)
    answer = table.lesson.not_begun(Status.NO_GAME, 'game did not answer within 5 s')
    assert answer.status is Status.NO_GAME
    assert table.lesson.phase is Phase.READY
    assert 'game did not answer' in table.lesson.view.text
    assert table.lesson.prepare().ok


def test_the_first_state_may_come_before_or_after_games_answer(table: Table) -> None:
    state = table.ready().lesson.prepare().state
    table.episode = 4
    table.lesson.began(4, state)
    assert not table.lesson.reached(4, 0)
    table.arrives(state)
    assert table.lesson.reached(4, 0)
    assert table.drive('west').end().ok


def test_late_states_of_earlier_episodes_do_not_end_a_demonstration(table: Table) -> None:
    state = table.ready().lesson.prepare().state
    table.lesson.began(4, state)
    table.episode = 3
    table.arrives(START)
    table.drive('west')
    assert table.lesson.phase is Phase.DEMONSTRATING
    table.episode = 4
    table.arrives(state)
    assert table.drive('west').end().ok


def test_a_reset_by_somebody_else_ends_the_demonstration(table: Table) -> None:
    table.ready().began(START).drive('west')
    table.episode += 1
    assert table.arrives(START)
    view = table.lesson.view
    assert view.phase is Phase.READY
    assert 'reset by somebody else' in view.text
    assert table.lesson.demonstrations() == []
    assert table.end().status is Status.WRONG_PHASE


def test_a_reset_before_the_first_state_came_ends_the_demonstration(table: Table) -> None:
    table.lesson.began(1, table.ready().lesson.prepare(START).state)
    table.episode = 2
    assert table.arrives(START)
    assert 'reset by somebody else' in table.lesson.view.text


def test_a_machines_step_ends_the_demonstration(table: Table) -> None:
    table.ready().began(START).drive('west', source=Source.MACHINE)
    assert table.lesson.phase is Phase.READY
    assert 'option or a policy moved' in table.lesson.view.text


def test_a_lost_state_ends_the_demonstration(table: Table) -> None:
    table.ready().began(START).drive('west')
    assert table.here is not None
    table.lesson.saw(replace(table.here, step=3))
    assert table.lesson.phase is Phase.READY
    assert 'step 3 of episode 1 came after step 1' in table.lesson.view.text


def test_an_episode_that_begins_elsewhere_is_not_the_one_asked_for(table: Table) -> None:
    table.lesson.began(1, table.ready().lesson.prepare(START).state)
    table.episode = 1
    assert table.arrives('taxi 4,4 passenger B destination R')
    assert 'began in taxi 4,4' in table.lesson.view.text


def test_steps_that_break_the_rules_are_refused_and_discarded(table: Table) -> None:
    table.ready().began(START).drive('west')
    assert table.here is not None
    table.here = replace(
        table.here, step=2, previous_action='north', state='taxi 4,4 passenger R destination G'
    )
    table.here = replace(
        table.here, features=tuple(TAXI.feature_values(TAXI.decode(table.here.state)).tolist())
    )
    table.lesson.saw(table.here)
    answer = table.end()
    assert answer.status is Status.REFUSED
    assert 'north does not lead' in answer.detail
    assert table.lesson.phase is Phase.READY
    assert table.lesson.demonstrations() == []


def test_a_reward_that_is_not_a_number_is_refused(table: Table) -> None:
    table.ready().began(START).drive('west')
    assert table.here is not None
    table.here = replace(table.here, step=2, reward=float('nan'))
    table.lesson.saw(table.here)
    assert 'not finite' in table.end().detail


def test_the_text_says_when_the_task_is_over(table: Table) -> None:
    table.ready().began('taxi 0,4 passenger aboard destination G').drive('dropoff')
    assert 'The task is over' in table.lesson.view.text
    kept = table.end().demonstration
    assert kept is not None
    assert kept.terminated


def test_what_cannot_be_written_is_not_lost_and_can_be_tried_again(
    table: Table, monkeypatch: pytest.MonkeyPatch
) -> None:
    table.ready().began(START).drive('west')
    with monkeypatch.context() as patch:
        _fill_disk(patch)
        answer = table.end()
        assert answer.status is Status.NOT_SAVED
        assert 'disk is full' in answer.detail
        assert table.lesson.phase is Phase.DEMONSTRATING
    assert table.end().ok


@pytest.mark.parametrize(
    ('phase', 'request_name'),
    [
        (Phase.NO_SESSION, 'open_session'),
        (Phase.NO_OPTION, 'define_option'),
        (Phase.ASKING, 'answer_question'),
    ],
)
def test_a_full_disk_is_told_and_changes_nothing(
    table: Table, monkeypatch: pytest.MonkeyPatch, phase: Phase, request_name: str
) -> None:
    before = TO_PHASE[phase](table).lesson.view
    with monkeypatch.context() as patch:
        _fill_disk(patch)
        assert REQUESTS[request_name](table).status is Status.NOT_SAVED
    assert table.lesson.view == before
    assert REQUESTS[request_name](table).ok


def _fill_disk(patch: pytest.MonkeyPatch) -> None:
    def full(handle: int) -> None:
        raise OSError(errno.ENOSPC, 'No space left on device')

    patch.setattr(os, 'fsync', full)


def test_the_lesson_waits_until_the_newest_demonstration_is_counted_in(table: Table) -> None:
    learning(table)
    table.lesson.learner_said([Progress('p1', OPTION, CHOSEN, 'older', True)])
    assert table.lesson.phase is Phase.LEARNING
    table.lesson.learner_said([Progress('p2', OPTION, CHOSEN, table.lesson.awaited, True)])
    assert table.lesson.phase is Phase.LEARNING
    table.learned()
    assert table.lesson.phase is Phase.READY


def test_the_lesson_waits_until_start_states_know_of_the_demonstration(table: Table) -> None:
    table.starts.known = set()
    learning(table).learned()
    assert table.lesson.phase is Phase.LEARNING
    table.starts.known.add(table.lesson.awaited)
    table.lesson.starts_know_more()
    assert table.lesson.phase is Phase.READY


def test_not_here_alone_teaches_start_states_nothing(table: Table) -> None:
    table.starts.known = set()
    assert table.ready().began().end(Verdict.NOT_HERE).ok
    table.learned()
    assert table.lesson.phase is Phase.READY


def test_a_learner_that_refuses_is_quoted(table: Table) -> None:
    uuid = learning(table).lesson.awaited
    table.lesson.learner_refused('another', 'not this one')
    assert table.lesson.phase is Phase.LEARNING
    table.lesson.learner_refused(uuid, 'it has no steps')
    assert table.lesson.phase is Phase.READY
    assert 'it has no steps' in table.lesson.view.text


def test_a_silent_learner_does_not_stop_the_lesson(table: Table) -> None:
    learning(table).lesson.learner_silent()
    assert table.lesson.phase is Phase.READY
    assert 'learner does not answer' in table.lesson.view.text
    assert table.shown().lesson.view.n_demonstrations == 2


def test_criteria_that_hold_finish_the_option(table: Table) -> None:
    view = met(table).lesson.view
    assert (view.phase, view.criteria_met) == (Phase.FINISHED, True)
    assert 'All criteria hold' in view.text
    assert table.lesson.define_option('the next').ok
    assert table.lesson.phase is Phase.ASKING
    table.lesson.define_option(OPTION)
    assert table.lesson.phase is Phase.FINISHED


def test_a_strategy_with_something_left_to_ask_goes_on(table: Table) -> None:
    table.starts.more = True
    met(table)
    assert (table.lesson.phase, table.lesson.criteria_met) == (Phase.READY, True)
    table.starts.more = False
    table.shown()
    assert table.lesson.phase is Phase.READY  # the criteria hold no longer
    table.learned(met=True)
    assert table.lesson.phase is Phase.FINISHED


@pytest.mark.parametrize('not_here', [0, 2])
def test_the_budget_ends_the_lesson_whatever_the_criteria_say(table: Table, not_here: int) -> None:
    table.ready()
    for number in range(5):
        assert table.lesson.phase is Phase.READY
        table.began(START)
        verdict = Verdict.NOT_HERE if number < not_here else Verdict.DONE
        table.drive(*(() if number < not_here else ('west',)))
        assert table.end(verdict).ok
        table.learned()
    assert table.lesson.phase is Phase.FINISHED
    assert 'budget of 5 is spent. Not all criteria hold.' in table.lesson.view.text
    assert table.lesson.prepare().status is Status.BUDGET_SPENT


def test_the_budget_counts_for_each_option(table: Table) -> None:
    spent(table)
    assert table.lesson.define_option('another').ok
    table.answer_all()
    assert table.lesson.phase is Phase.READY


def test_a_lesson_is_taken_up_after_a_restart_where_it_was_left(
    store: DemonstrationStore,
) -> None:
    table = Table(store).ready().shown()
    table.lesson.define_option('half asked')
    table.lesson.answer_question(table.lesson.view.question_id, True)
    left = table.lesson.view

    resumed = Table(store)
    answer = resumed.lesson.open_session('p1', 's1')
    assert answer.known_options == (OPTION, 'half asked')
    assert resumed.lesson.view == left
    assert resumed.lesson.define_option(OPTION).resumed
    assert resumed.lesson.view.chosen_features == CHOSEN
    kept = resumed.began().drive('west').end().demonstration
    assert kept is not None
    assert kept.number == 2
    assert [demo.number for demo in resumed.lesson.demonstrations()] == [1, 2]


def test_another_session_begins_without_an_option_and_keeps_the_counts(
    store: DemonstrationStore,
) -> None:
    Table(store).ready().shown()
    resumed = Table(store)
    assert resumed.lesson.open_session('p1', 's2').known_options == (OPTION,)
    assert resumed.lesson.phase is Phase.NO_OPTION
    resumed.lesson.define_option(OPTION)
    assert resumed.lesson.view.n_demonstrations == 1


def test_participants_and_domains_are_kept_apart(store: DemonstrationStore) -> None:
    Table(store).ready().shown()
    assert Table(store).lesson.open_session('p2', 's1').known_options == ()
    other: list[Entry] = [
        replace(demo, domain_parameters='{"rows": 9}')
        for demo in Table(store).lesson.demonstrations()
    ]
    store.append(other[0])
    assert len(Table(store).lesson.demonstrations()) == 1
    assert Table(store).defined().lesson.view.n_demonstrations == 1


def test_criteria_learned_before_a_restart_still_hold(store: DemonstrationStore) -> None:
    met(Table(store))
    resumed = Table(store)
    resumed.learned(met=True)
    resumed.opened()
    assert resumed.lesson.phase is Phase.FINISHED


def test_the_same_lesson_gives_the_same_uuids_and_any_difference_others(tmp_path: Path) -> None:
    def uuid(folder: str, *steps: str, seconds: float = 0.0) -> str:
        with DemonstrationStore(tmp_path / folder) as store:
            table = Table(store).ready().began(START)
            table.time += seconds
            kept = table.drive(*steps).end().demonstration
            assert kept is not None
            return kept.uuid

    assert uuid('a', 'west') == uuid('b', 'west', seconds=9.0)
    assert uuid('c', 'south') != uuid('d', 'west')


def test_the_newest_demonstration_can_be_taken_back_and_shown_anew(table: Table) -> None:
    table.ready().shown()
    first = table.lesson.view.last_uuid
    table.began(OTHER).drive('west').end()
    table.learned()
    newest = table.lesson.view.last_uuid
    answer = table.lesson.withdraw(newest)
    assert answer.ok
    assert answer.demonstration is not None
    assert (answer.demonstration.uuid, answer.demonstration.withdrawn) == (newest, True)
    view = table.lesson.view
    assert (view.phase, view.n_demonstrations, view.last_uuid) == (Phase.LEARNING, 1, first)
    table.learned()
    assert table.lesson.phase is Phase.LEARNING  # the learner has not counted it out yet
    table.lesson.learner_said([Progress('p1', OPTION, CHOSEN, first, False)])
    assert table.lesson.prepare().state == OTHER


def test_what_was_taken_back_gives_its_place_in_the_budget_but_not_its_number(
    table: Table,
) -> None:
    spent(table)
    assert table.lesson.withdraw().ok
    table.lesson.learner_said([])
    assert table.lesson.phase is Phase.READY
    again = table.began().drive('west').end().demonstration
    assert again is not None
    assert again.number == 6


def test_a_lesson_that_was_finished_goes_on_without_what_made_it_so(table: Table) -> None:
    met(table)
    assert table.lesson.withdraw().ok
    table.lesson.learner_said([])  # the option has no demonstration left
    assert (table.lesson.phase, table.lesson.criteria_met) == (Phase.READY, False)


def test_only_the_newest_of_the_option_that_is_taught_can_be_taken_back(table: Table) -> None:
    table.ready().shown()
    older = table.lesson.view.last_uuid
    table.shown()
    refused = table.lesson.withdraw(older)
    assert refused.status is Status.NO_DEMONSTRATION
    assert older in refused.detail
    table.lesson.define_option('another')
    assert table.lesson.withdraw().status is Status.NO_DEMONSTRATION
    assert table.lesson.demonstrations()[1].withdrawn is False


def test_what_was_taken_back_stays_so_after_a_restart_and_is_told_to_the_learner(
    store: DemonstrationStore,
) -> None:
    table = Table(store).ready().shown().shown()
    newest = table.lesson.view.last_uuid
    table.lesson.withdraw()
    resumed = Table(store)
    resumed.lesson.open_session('p1', 's1')
    assert resumed.lesson.view.n_demonstrations == 1
    told = [(demo.uuid, demo.withdrawn) for demo in resumed.lesson.demonstrations()]
    assert told == [(resumed.lesson.view.last_uuid, False), (newest, True)]


def test_a_withdrawal_that_cannot_be_written_changes_nothing(
    table: Table, monkeypatch: pytest.MonkeyPatch
) -> None:
    view = table.ready().shown().lesson.view
    with monkeypatch.context() as patch:
        _fill_disk(patch)
        assert table.lesson.withdraw().status is Status.NOT_SAVED
    assert table.lesson.view == view
    assert table.lesson.withdraw().ok


def test_a_learner_that_does_not_take_a_withdrawal_is_quoted(table: Table) -> None:
    table.ready().shown().lesson.withdraw()
    table.lesson.learner_refused(table.lesson.awaited, 'cannot write')
    assert table.lesson.phase is Phase.READY
    assert 'did not take the demonstration back: cannot write' in table.lesson.view.text
    table.shown().lesson.withdraw()
    table.lesson.learner_silent()
    assert 'taken back is on disk' in table.lesson.view.text


def test_start_states_are_drawn_only_once_they_know_of_a_withdrawal(table: Table) -> None:
    table.ready().shown().shown()
    uuid = table.lesson.view.last_uuid
    table.starts.known = {uuid}
    table.lesson.withdraw()
    table.lesson.learner_said([])
    assert table.lesson.phase is Phase.LEARNING
    table.starts.known.clear()
    table.lesson.starts_know_more()
    assert table.lesson.phase is Phase.READY
