"""The lesson: every request in every phase, and a demonstration from its start to its verdict."""

from dataclasses import replace
from pathlib import Path

from humanopts_env.game import Source, Transition
from humanopts_learner.demonstrations import Kind
from humanopts_teach.lesson.requests import (
    Answer,
    AnswerQuestion,
    BeginDemonstration,
    ChangeOption,
    DefineOption,
    EndDemonstration,
    LessonRequest,
    ListDemonstrations,
    OpenSession,
    Phase,
    RequestStatus,
    settled,
    Verdict,
    WithdrawDemonstration,
    World,
)
from humanopts_teach.lesson.store import DemonstrationStore
import pytest
from teach_support.lesson import (
    CHOSEN,
    fill_disk,
    met,
    OPTION,
    preparing,
    START,
    Table,
    TAXI,
    TO_PHASE,
)

_EVERYWHERE_WRONG = dict.fromkeys(Phase, RequestStatus.WRONG_PHASE)
_EVERYWHERE_OK = dict.fromkeys(Phase, RequestStatus.OK)
# What each request answers in each phase.
TABLE: dict[LessonRequest, dict[Phase, RequestStatus]] = {
    OpenSession('p2'): _EVERYWHERE_OK | {Phase.DEMONSTRATING: RequestStatus.WRONG_PHASE},
    DefineOption('another'): _EVERYWHERE_OK
    | dict.fromkeys((Phase.NO_SESSION, Phase.DEMONSTRATING), RequestStatus.WRONG_PHASE),
    AnswerQuestion(1, yes=True): dict.fromkeys(Phase, RequestStatus.NOT_ASKED)
    | {Phase.ASKING: RequestStatus.OK},
    BeginDemonstration(): _EVERYWHERE_WRONG
    | dict.fromkeys((Phase.READY, Phase.FINISHED), RequestStatus.OK),
    AnswerQuestion(0, back=True): dict.fromkeys(Phase, RequestStatus.NOT_ASKED)
    | dict.fromkeys((Phase.READY, Phase.LEARNING, Phase.FINISHED), RequestStatus.OK),
    ChangeOption(OPTION, 'another'): _EVERYWHERE_OK
    | dict.fromkeys((Phase.DEMONSTRATING, Phase.LEARNING), RequestStatus.WRONG_PHASE)
    | dict.fromkeys((Phase.NO_SESSION, Phase.NO_OPTION), RequestStatus.NO_OPTION),
    WithdrawDemonstration(): _EVERYWHERE_WRONG
    | dict.fromkeys((Phase.ASKING, Phase.READY), RequestStatus.NO_DEMONSTRATION)
    | {Phase.FINISHED: RequestStatus.OK},
    ListDemonstrations(): _EVERYWHERE_OK
    | dict.fromkeys((Phase.NO_SESSION, Phase.NO_OPTION), RequestStatus.NO_OPTION),
    EndDemonstration(Verdict.DONE, 1, 0): _EVERYWHERE_WRONG
    | {Phase.DEMONSTRATING: RequestStatus.NO_STEPS},
}
NEW_THINGS = list(TABLE)[:-2]
FULL = 'recording stopped: the disk is full'


@pytest.mark.parametrize('phase', Phase, ids=lambda phase: phase.name)
@pytest.mark.parametrize('asked', TABLE, ids=repr)
def test_every_request_is_answered_in_every_phase(
    table: Table, phase: Phase, asked: LessonRequest
) -> None:
    TO_PHASE[phase](table)
    assert table.lesson.phase is phase
    answer = table.ask(asked)
    assert answer.status is TABLE[asked][phase]
    assert answer.detail
    if not answer.ok:
        assert table.lesson.phase is phase


@pytest.mark.parametrize('phase', Phase, ids=lambda phase: phase.name)
@pytest.mark.parametrize('asked', NEW_THINGS, ids=repr)
def test_while_it_is_paused_nothing_new_begins_and_then_all_goes_on(
    table: Table, phase: Phase, asked: LessonRequest
) -> None:
    view = TO_PHASE[phase](table).lesson.view
    table.lesson.pause(FULL)
    assert table.ask(asked) == Answer(RequestStatus.PAUSED, f'the lesson is paused: {FULL}')
    paused = table.lesson.view
    assert (paused.phase, paused.paused) == (phase, FULL)
    assert paused.text
    table.lesson.pause('')
    assert table.lesson.view == view
    assert table.ask(asked).status is TABLE[asked][phase]


def test_a_demonstration_under_way_is_kept_while_paused_and_said_to_be_unrecorded(
    table: Table,
) -> None:
    table.ready().began(START).drive('west')
    table.lesson.pause(FULL)
    assert table.drive('west').end(Verdict.NOT_HERE).status is RequestStatus.STEPS_TAKEN
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
    assert table.ask(BeginDemonstration()).state == START


def test_an_episode_that_begins_after_the_pause_is_no_demonstration(table: Table) -> None:
    table.ready().ask(BeginDemonstration(START))
    table.lesson.pause(FULL)
    assert table.lesson.began(1, START).status is RequestStatus.PAUSED
    assert table.lesson.phase is Phase.READY
    table.lesson.pause('')
    assert table.ask(BeginDemonstration()).ok


@pytest.mark.parametrize('phase', Phase, ids=lambda phase: phase.name)
def test_every_phase_says_what_comes_next(table: Table, phase: Phase) -> None:
    view = TO_PHASE[phase](table).lesson.view
    assert view.phase is phase
    assert view.text


@pytest.mark.parametrize('asked', NEW_THINGS, ids=repr)
def test_nothing_comes_between_the_request_for_an_episode_and_its_start(
    table: Table, asked: LessonRequest
) -> None:
    answer = preparing(table).ask(asked)
    assert answer.status in (RequestStatus.WRONG_PHASE, RequestStatus.NOT_ASKED)


@pytest.mark.parametrize(
    ('participant', 'session'),
    [
        ('', 's1'),
        ('a b', ''),
        ('../x', ''),
        ('..', ''),
        ('x' * 61, ''),
        ('Zo\u00eb', ''),
        ('p1', 's/1'),
    ],
)
def test_a_session_needs_codes(table: Table, participant: str, session: str) -> None:
    assert table.ask(OpenSession(participant, session)).status is RequestStatus.BAD_NAME
    assert table.lesson.phase is Phase.NO_SESSION
    assert [path.name for path in table.store.directory.iterdir()] == ['.lock']


def test_a_new_session_is_named_after_the_day_and_counted(table: Table) -> None:
    assert table.ask(OpenSession('p1', '')).session == '20260102-1'
    assert table.ask(OpenSession('p1', '')).session == '20260102-2'
    assert table.ask(OpenSession('p2', '')).session == '20260102-1'


@pytest.mark.parametrize(
    'name', ['', '   ', 'x' * 61, 'two\nlines', 'bell\a', 'action:north', '\u200b']
)
def test_an_option_needs_a_name_that_can_be_shown(table: Table, name: str) -> None:
    assert table.opened().ask(DefineOption(name)).status is RequestStatus.BAD_NAME
    assert table.lesson.phase is Phase.NO_OPTION


def test_one_question_is_asked_for_each_feature_in_the_words_of_the_paper(table: Table) -> None:
    view = table.defined().lesson.view
    assert view.question == f"Does the '{OPTION}' option depend on {TAXI.features[0].question}?"
    assert (view.question_id, view.questions_total) == (1, len(TAXI.features))
    table.answer_all()
    assert table.lesson.view.chosen_features == CHOSEN
    assert table.lesson.view.question_id == 0


def test_an_answer_to_another_question_changes_nothing(table: Table) -> None:
    table.defined().ask(AnswerQuestion(1, True))
    again = table.ask(AnswerQuestion(1, True))
    assert again.status is RequestStatus.NOT_ASKED
    assert 'question 2 is' in again.detail
    assert table.lesson.view.question_id == 2


def test_the_questions_are_asked_again_when_all_answers_are_no(table: Table) -> None:
    assert table.defined().answer_all(()).status is RequestStatus.NO_FEATURE
    view = table.lesson.view
    assert view.phase is Phase.ASKING
    assert (view.question_feature, view.question_id) == (TAXI.features[0].name, 11)
    assert 'no' in view.text
    assert table.answer_all().ok


def test_asking_again_forgets_the_answers_and_keeps_the_demonstrations(table: Table) -> None:
    met(table)
    answer = table.ask(DefineOption(OPTION, ask_again=True))
    assert (answer.status, answer.resumed) == (RequestStatus.OK, True)
    assert table.lesson.phase is Phase.ASKING
    assert table.lesson.view.n_demonstrations == 1
    table.answer_all(CHOSEN[:2])
    assert table.lesson.phase is Phase.READY  # the criteria held on other features
    assert not table.lesson.criteria_met


@pytest.mark.parametrize(
    ('phase', 'asked'),
    [
        (Phase.NO_SESSION, OpenSession('p2')),
        (Phase.NO_OPTION, DefineOption('another')),
        (Phase.ASKING, AnswerQuestion(1, yes=True)),
    ],
)
def test_a_full_disk_is_told_and_changes_nothing(
    table: Table, monkeypatch: pytest.MonkeyPatch, phase: Phase, asked: LessonRequest
) -> None:
    before = TO_PHASE[phase](table).lesson.view
    with monkeypatch.context() as patch:
        fill_disk(patch)
        assert table.ask(asked).status is RequestStatus.NOT_SAVED
    assert table.lesson.view == before
    assert table.ask(asked).ok


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
        ((), Verdict.DONE, RequestStatus.NO_STEPS),
        (('west',), Verdict.NOT_HERE, RequestStatus.STEPS_TAKEN),
        (('west',), None, RequestStatus.BAD_VERDICT),
    ],
)
def test_a_verdict_that_does_not_fit_lets_the_demonstration_go_on(
    table: Table, steps: tuple[str, ...], verdict: Verdict | None, status: RequestStatus
) -> None:
    table.ready().began(START).drive(*steps)
    assert table.end(verdict).status is status
    assert table.drive('west', 'west', 'pickup').end().ok


@pytest.mark.parametrize(('episode', 'step'), [(1, 0), (1, 2), (2, 1), (0, 1)])
def test_a_verdict_on_another_state_is_not_carried_out(
    table: Table, episode: int, step: int
) -> None:
    table.ready().began(START).drive('west')
    answer = table.ask(EndDemonstration(Verdict.DONE, episode, step, False))
    assert answer.status is RequestStatus.NOT_CURRENT
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
    assert table.ask(EndDemonstration(Verdict.DISCARD, 0, 0, False)).ok
    view = table.lesson.view
    assert (view.phase, view.n_demonstrations, view.start_state) == (Phase.READY, 0, '')
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
    answer = table.ready().ask(BeginDemonstration(text))
    assert answer.status is RequestStatus.BAD_STATE
    assert says in answer.detail
    assert table.ask(BeginDemonstration()).ok


def test_a_game_that_does_not_answer_leaves_the_lesson_ready(table: Table) -> None:
    preparing(table)
    answer = table.lesson.not_begun(RequestStatus.NO_GAME, 'game did not answer within 5 s')
    assert answer.status is RequestStatus.NO_GAME
    assert table.lesson.phase is Phase.READY
    assert 'game did not answer' in table.lesson.view.text
    assert table.ask(BeginDemonstration()).ok


def test_the_first_state_may_come_before_or_after_games_answer(table: Table) -> None:
    state = table.ready().ask(BeginDemonstration()).state
    table.episode = 4
    table.lesson.began(4, state)
    assert not table.lesson.reached(4, 0)
    table.arrives(state)
    assert table.lesson.reached(4, 0)
    assert table.drive('west').end().ok


def test_late_states_of_earlier_episodes_do_not_end_a_demonstration(table: Table) -> None:
    state = table.ready().ask(BeginDemonstration()).state
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
    assert table.end().status is RequestStatus.WRONG_PHASE


def test_a_reset_before_the_first_state_came_ends_the_demonstration(table: Table) -> None:
    begin = BeginDemonstration(START)
    begun = table.lesson.began(1, table.ready().ask(begin).state)
    table.episode = 2
    assert table.arrives(START)
    view = table.lesson.view
    assert (view.phase, view.start_state) == (Phase.READY, '')
    assert 'reset by somebody else' in view.text
    # A client that sees no earlier view does not wait for one.
    assert settled(begin, begun, World(game=Transition(episode=2), lesson=view))


def test_a_machines_step_ends_the_demonstration(table: Table) -> None:
    table.ready().began(START).drive('west', source=Source.MACHINE)
    assert table.lesson.phase is Phase.READY
    assert 'option or a policy moved' in table.lesson.view.text


def test_a_lost_state_ends_the_demonstration(table: Table) -> None:
    table.ready().began(START).drive('west')
    assert table.here is not None
    table.lesson.add_transition(replace(table.here, step=3))
    assert table.lesson.phase is Phase.READY
    assert 'step 3 of episode 1 came after step 1' in table.lesson.view.text


def test_an_episode_that_begins_elsewhere_is_not_the_one_asked_for(table: Table) -> None:
    table.lesson.began(1, table.ready().ask(BeginDemonstration(START)).state)
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
    table.lesson.add_transition(table.here)
    answer = table.end()
    assert answer.status is RequestStatus.REFUSED
    assert 'north does not lead' in answer.detail
    assert table.lesson.phase is Phase.READY
    assert table.lesson.demonstrations() == []


def test_a_reward_that_is_not_a_number_is_refused(table: Table) -> None:
    table.ready().began(START).drive('west')
    assert table.here is not None
    table.here = replace(table.here, step=2, reward=float('nan'))
    table.lesson.add_transition(table.here)
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
        fill_disk(patch)
        answer = table.end()
        assert answer.status is RequestStatus.NOT_SAVED
        assert 'disk is full' in answer.detail
        assert table.lesson.phase is Phase.DEMONSTRATING
    assert table.end().ok


def test_what_a_person_did_is_read_when_the_session_opens_and_an_unreadable_file_is_told(
    table: Table, store: DemonstrationStore
) -> None:
    kept = table.ready().began(START).drive('west').end().demonstration
    assert kept in store.entries('p1')
    assert table.ask(OpenSession('p2')).ok
    path = store.directory / 'p1.jsonl'
    aside = path.rename(path.with_suffix('.aside'))
    path.mkdir()
    answer = table.ask(OpenSession('p1'))
    assert answer.status is RequestStatus.NOT_SAVED
    assert 'cannot read what p1 did' in answer.detail
    assert table.lesson.view.participant == 'p2'
    path.rmdir()
    aside.rename(path)
    assert table.ask(OpenSession('p1')).ok
    assert kept in store.entries('p1')


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


def test_a_game_that_is_started_again_ends_the_demonstration_under_way(table: Table) -> None:
    table.ready().began(START).drive('west')
    assert table.lesson.game_restarted()
    view = table.lesson.view
    assert view.phase is Phase.READY
    assert 'the game was started again' in view.text
    assert view.episode == 0
    assert table.end().status is RequestStatus.WRONG_PHASE
    assert not table.lesson.game_restarted()  # nothing is under way
    table.began()
    assert table.lesson.view.start_state == START  # it is asked for again


def test_a_lesson_that_is_started_again_goes_on_where_the_other_was(table: Table) -> None:
    table.ready().shown()
    table.began(START).drive('west')
    again = Table(table.store)
    assert again.lesson.resume('p1', 's1').ok
    view = again.lesson.view
    assert (view.session, view.option_name, view.chosen_features) == ('s1', OPTION, CHOSEN)
    assert (view.phase, view.n_demonstrations) == (Phase.LEARNING, 1)
    assert 'was started again; a demonstration that was under way is given up' in view.text
    again.learned()  # the newest, of which the lesson does not know whether it is counted in
    assert again.lesson.phase is Phase.READY
    assert again.shown().lesson.view.n_demonstrations == 2


def test_a_name_is_the_same_however_its_letters_were_typed(table: Table) -> None:
    assert table.ask(OpenSession('p1')).ok
    assert table.ask(DefineOption('abhängen')).ok
    again = table.ask(DefineOption('abha\u0308ngen'))
    assert again.resumed
    assert table.ask(ChangeOption('abha\u0308ngen', 'höher')).known_options == ('höher',)
    assert table.ask(ListDemonstrations('ho\u0308her')).ok


def test_a_code_that_differs_only_in_case_is_refused(table: Table) -> None:
    assert table.ask(OpenSession('p1')).ok
    assert table.ask(OpenSession('p2')).ok
    answer = table.ask(OpenSession('P1'))
    assert answer.status is RequestStatus.BAD_NAME
    assert "'P1' differs only in case from 'p1'" in answer.detail
    assert table.ask(OpenSession('p1')).ok
