"""What the lesson answers, as a transcript, and what it keeps."""

from contextlib import ExitStack
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

from humanopts_env.domains.registry import make_domain
from humanopts_env.game import Source, Transition
from humanopts_learner.demonstrations import GOAL, Kind, TREES
from humanopts_teach.lesson import requests
from humanopts_teach.lesson.notebook import MAX_DERIVED
from humanopts_teach.lesson.requests import (
    Answer,
    AnswerQuestion,
    BeginDemonstration,
    DefineOption,
    LessonRequest,
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
from teach_support import snapshot
from teach_support.lesson import (
    CHOSEN,
    fill_disk,
    OPTION,
    OTHER,
    START,
    status,
    Table,
    TAXI,
    TO_PHASE,
)

OK, WRONG, MACHINE = RequestStatus.OK, RequestStatus.WRONG_PHASE, Source.MACHINE
FEATURES = [feature.name for feature in TAXI.features]
# of the script, besides requests and commands
NAMES: dict[str, object] = {'GOAL': GOAL, 'TREES': TREES, 'MACHINE': MACHINE}
NAMES |= {'OPTION': OPTION, 'OTHER': OTHER, 'START': START}


class Transcript(Table):
    """A lesson that writes down what is answered."""

    lines: list[str]

    def ask(self, request: LessonRequest) -> Answer:
        answer = super().ask(request)
        self.lines.append(f'    {answer.status.name}: {answer.detail}')
        if answer.contradiction:
            newest = (*self.lesson.demonstrations(), *answer.unsent)
            number = next(d.number for d in newest if d.uuid == answer.contradicts)
            where = f'{answer.situation}, number {number}'
            self.lines.append(f'    in {where}: {answer.contradiction}')
        return answer


class Script:
    """The commands of ``lesson.txt``; each lesson has a folder of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.lines, self.stores = folder, list[str](), ExitStack()

    def start(self, phase: str, domain: str = 'taxi', **options: Any) -> None:
        """Begin a lesson in a phase; nothing before is written down."""
        number = len(list(self.folder.iterdir()))
        store = self.stores.enter_context(DemonstrationStore(self.folder / str(number)))
        self.table = Transcript(store, domain=make_domain(domain), **options)
        self.table.lines = []
        if phase == 'driven':
            self.table.ready().began(START).drive('west')
        else:
            TO_PHASE[Phase(phase)](self.table)
        self.table.lines = self.lines

    def taught(self, method: str) -> None:
        self.start('asking')
        self.table.lines = []
        self.table.answer_all((*CHOSEN, 'passenger_in_taxi'))
        self.table.ask(DefineOption(OPTION, method=method))
        self.table.lines = self.lines

    def ask(self, *requests: LessonRequest) -> None:
        for request in requests:
            self.table.ask(request)

    def show(self, *actions: str) -> None:
        self.table.began(START).drive(*actions).end(Verdict.DONE if actions else Verdict.NOT_HERE)
        self.table.learned()

    def moved(self, **changes: Any) -> None:
        """Have another state come than the one after the last."""
        assert self.table.here is not None
        self.table.here = replace(self.table.here, **changes)
        self.table.lesson.add_transition(self.table.here)

    def resume(self) -> None:
        """Begin a lesson in the folder of the last one."""
        self.table = Transcript(self.table.store)
        self.table.lines = self.lines
        self.table.lesson.resume('p1', 's1')

    def news(self) -> None:
        """Write down what the lesson shows."""
        self.lines.append(f'    [{self.table.lesson.phase.value}] {self.table.lesson.view.text}')


def test_what_is_asked_and_what_happens_is_answered_in_words(tmp_path: Path) -> None:
    """Lines that begin with ">" are done; the others are what comes of them."""
    script = Script(tmp_path)
    commands = {name: getattr(script, name) for name in vars(Script) if name[0] != '_'}
    with script.stores:
        for line in (snapshot.FOLDER / 'lesson.txt').read_text('utf-8').splitlines():
            if not line.startswith('    '):
                script.lines.append(line)
            if line.startswith('> '):
                exec(line[2:], {**vars(requests), **NAMES, **commands, **vars(script)})
        snapshot.check('lesson.txt', '\n'.join(script.lines))


def test_a_demonstration_holds_what_was_shown(table: Table) -> None:
    table.ready().began(START)
    table.time += 2.5
    kept = table.drive('west', 'west', 'pickup').end(again=True).demonstration
    assert kept is not None
    assert kept.kind is Kind.TRAJECTORY
    assert (kept.states[0], len(kept.states), len(kept.features)) == (START, 4, 4)
    assert kept.actions == ('west', 'west', 'pickup')
    assert kept.rewards == (-1.0, -1.0, 0.0)
    assert (kept.participant, kept.session, kept.option_name) == ('p1', 's1', OPTION)
    assert (kept.number, kept.chosen_features) == (1, CHOSEN)
    assert (kept.can_start_at_end, kept.terminated, kept.seconds) == (True, False, 2.5)
    table.learned()
    refusal = table.began(START).end(Verdict.NOT_HERE, again=True).demonstration
    assert refusal is not None
    assert (refusal.kind, refusal.states, refusal.actions) == (Kind.NOT_HERE, (START,), ())
    assert not refusal.can_start_at_end


def test_the_same_lesson_gives_the_same_uuids_and_any_difference_others(tmp_path: Path) -> None:
    folders = count()

    def uuid(*steps: str, seconds: float = 0.0, by: Source = Source.PERSON) -> str:
        with DemonstrationStore(tmp_path / str(next(folders))) as store:
            table = Table(store).ready().began(START, watch=True)
            table.time += seconds
            return table.drive(*steps, source=by).drive('south').end(machine=True).uuid

    assert uuid('west') == uuid('west', seconds=9.0)
    assert len({uuid('west'), uuid('south'), uuid('west', by=MACHINE)}) == 3


def test_states_may_come_before_or_after_games_answer_and_late(table: Table) -> None:
    state = table.ready().ask(BeginDemonstration()).state
    table.lesson.began(4, state)
    table.episode = 3
    table.arrives(START)
    table.drive('west')  # of the episode before
    assert table.lesson.phase is Phase.DEMONSTRATING
    assert not table.lesson.reached(4, 0)
    table.episode = 4
    table.arrives(state)
    assert (table.lesson.reached(4, 0), table.lesson.reached(4, 1)) == (True, False)
    assert table.drive('west').end().ok
    table.learned()
    begin = BeginDemonstration(START)
    begun = table.lesson.began(5, table.ask(begin).state)
    table.episode = 6  # another client has reset the game
    assert table.arrives(START)
    view = table.lesson.view
    assert (view.phase, view.start_state) == (Phase.READY, '')
    # A client that sees no earlier view does not wait for one.
    assert settled(begin, begun, World(game=Transition(episode=6), lesson=view))


def test_an_episode_that_begins_after_the_pause_is_no_demonstration(table: Table) -> None:
    table.ready().ask(BeginDemonstration(START))
    for asked in (OpenSession('p2'), DefineOption('b'), WithdrawDemonstration()):
        assert table.ask(asked).status is WRONG  # nothing comes between
    table.lesson.pause('The disk is full.')
    assert table.lesson.began(1, START).status is RequestStatus.PAUSED
    assert table.lesson.phase is Phase.READY


def test_an_unreadable_file_of_a_participant_is_reported(table: Table) -> None:
    kept = table.ready().began(START).drive('west').end().demonstration
    assert table.ask(OpenSession('p2')).ok
    path = table.store.directory / 'p1.jsonl'
    aside = path.rename(path.with_suffix('.aside'))
    path.mkdir()
    answer = table.ask(OpenSession('p1'))
    assert answer.status is RequestStatus.NOT_SAVED
    assert 'cannot read what p1 did' in answer.detail
    assert table.lesson.view.participant == 'p2'
    path.rmdir()
    aside.rename(path)
    assert table.ask(OpenSession('p1')).ok
    assert kept in table.store.entries('p1')


def test_demonstrations_of_other_domains_are_kept_apart(store: DemonstrationStore) -> None:
    demo = Table(store).ready().began(START).drive('west').end().demonstration
    assert demo is not None
    store.append(replace(demo, domain_parameters='{"rows": 9}', uuid='another'))
    table = Table(store).defined()
    assert table.lesson.demonstrations() == [demo]
    assert table.lesson.view.n_demonstrations == 1


def test_an_option_goes_on_by_its_method_whatever_is_usual(store: DemonstrationStore) -> None:
    assert Table(store, method=GOAL).ready().began().drive('west').end().ok
    resumed = Table(store).opened()
    resumed.ask(DefineOption(OPTION))
    assert resumed.lesson.view.method == GOAL


def test_the_lesson_waits_for_learner_and_start_states(table: Table) -> None:
    table.ready()
    table.starts.known = set()
    assert table.began().end(Verdict.NOT_HERE).ok
    table.learned()
    assert table.lesson.phase is Phase.READY  # "not here" alone teaches start states nothing
    table.starts.known = None
    table.shown().starts.known = set()
    table.began(START).drive('west').end()
    for other in (status(last_uuid='older'), status('p2', last_uuid=table.lesson.awaited)):
        table.lesson.update_summaries([other])
        assert table.lesson.phase is Phase.LEARNING
    uuid = table.lesson.awaited
    table.learned()
    assert table.lesson.phase is Phase.LEARNING
    table.starts.known.add(uuid)
    table.lesson.update_option('p1', OPTION, 'the option')
    assert table.lesson.phase is Phase.READY
    table.ask(WithdrawDemonstration(uuid))
    table.lesson.update_summaries([])
    assert table.lesson.phase is Phase.LEARNING
    table.starts.known.clear()
    table.lesson.update_option('p1', OPTION, 'the option without it')
    assert table.lesson.phase is Phase.READY


OFFSET, NEAR = 'taxi_row - passenger_row', 'abs(taxi_row - passenger_row) < 2'


def test_a_derived_feature_is_asked_about_last_in_every_option_and_kept(
    table: Table, monkeypatch: pytest.MonkeyPatch
) -> None:
    table.opened()
    derived = DefineOption(OPTION, derived_features=('taxi_row-passenger_row', OFFSET))
    with monkeypatch.context() as patch:
        fill_disk(patch)
        assert table.ask(derived).status is RequestStatus.NOT_SAVED
    assert not table.lesson.view.derived_features
    assert table.ask(derived).detail == f'new option: {OPTION}; also asked about: {OFFSET}'
    assert table.lesson.view.questions_total == len(FEATURES) + 1
    table.answer_all()
    view = table.lesson.view
    assert (view.phase, view.question_feature) == (Phase.ASKING, OFFSET)
    assert view.question.endswith('depend on the value of taxi row minus passenger row?')
    assert table.ask(AnswerQuestion(view.question_id, yes=True)).ok
    demo = table.began(START).drive('west').end().demonstration
    assert demo is not None
    assert demo.chosen_features == (*CHOSEN, OFFSET)
    table.learned(features=demo.chosen_features)
    assert table.ask(DefineOption(OPTION, derived_features=(NEAR,))).ok  # one more question
    assert table.lesson.view.question_feature == NEAR
    resumed = Table(table.store).opened()
    view = resumed.lesson.view
    assert (view.derived_features, view.question_feature) == ((OFFSET, NEAR), NEAR)
    assert view.chosen_features == (*CHOSEN, OFFSET)
    assert resumed.ask(DefineOption('another')).ok
    assert resumed.lesson.view.questions_total == len(FEATURES) + 2
    resumed.ask(OpenSession('p2'))
    assert not resumed.lesson.view.derived_features


def test_a_bad_formula_changes_nothing_and_the_rules_add_theirs(store: DemonstrationStore) -> None:
    table = Table(store).opened()
    view, entries = table.lesson.view, store.entries('p1')
    answer = table.ask(DefineOption(OPTION, derived_features=(OFFSET, 'taxi_rwo - 1')))
    assert answer.status is RequestStatus.BAD_FEATURE
    assert answer.detail == ("taxi has no feature 'taxi_rwo'; did you mean taxi_row or taxi_col?")
    many = tuple(f'taxi_row - {number}' for number in range(1, MAX_DERIVED + 2))
    assert table.ask(DefineOption(OPTION, derived_features=many)).detail == (
        f'at most {MAX_DERIVED} derived features are allowed'
    )
    assert (table.lesson.view, store.entries('p1')) == (view, entries)
    table.starts.rules = replace(table.starts.rules, derive=(OFFSET,))
    assert table.ask(DefineOption(OPTION, derived_features=(NEAR,))).ok
    assert table.lesson.view.derived_features == (OFFSET, NEAR)


def test_a_repeated_demonstration_starts_in_the_same_state_with_other_random_outcomes(
    table: Table,
) -> None:
    table.ready()
    begun = list[tuple[str, int]]()
    for _ in range(3):
        answer = table.ask(BeginDemonstration())
        begun.append((answer.state, answer.seed))
        table.episode += 1
        table.arrives(answer.state)
        table.lesson.began(table.episode, answer.state)
        assert table.end(Verdict.DISCARD).ok
    states, seeds = zip(*begun)
    assert (len({*states}), len({*seeds})) == (1, 3)
