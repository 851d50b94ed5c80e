"""Studies: plans and orders, changed plans, what participants do at the keys, and the tables."""

from collections import Counter
from collections.abc import Callable
import itertools
import json
import os
from pathlib import Path
import time
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.pacman.maze import load_maze
from humanopts_env.game import Transition
from humanopts_learner.summary import OptionSummary
from humanopts_teach.cli import main
from humanopts_teach.commands.study_session import simulated_part
from humanopts_teach.dialogue.study import StudyApp
from humanopts_teach.lesson.requests import Answer, LessonView, Phase, RequestStatus, World
from humanopts_teach.study.plan import (
    balanced_latin_square,
    Part,
    PartKind,
    PARTS,
    PlanFileError,
    Question,
    Questionnaire,
    read_plan,
    StudyPlan,
)
from humanopts_teach.study.protocol import Protocol
from humanopts_teach.study.record import OpenRecord, StudyError, StudyFolder
from humanopts_teach.study.tables import CODEBOOK, status_table, tables
from humanopts_teach.terminal.drawing import frame
from hypothesis import given, HealthCheck, settings
from hypothesis import strategies as st
import pytest
from teach_support import snapshot
import yaml

START = 'taxi 2,3 passenger R destination B'
PLAN = """
study: trees-or-goal
consent: consent.md
welcome: welcome.md
all: {domain: taxi, free_play: 2, buttons: 3, teach: 10, questions: nasa-tlx}
conditions:
  - {name: trees}
  - {name: goal, learn: goal}
"""
Write = Callable[[str], Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Write a plan beside its pages."""
    (tmp_path / 'consent.md').write_text('# Taking part\nYou can stop.\n')
    (tmp_path / 'welcome.md').write_text('First.\n\n---\n\nSecond.\n')

    def write(text: str) -> Path:
        path = tmp_path / 'plan.yaml'
        path.write_text(text, encoding='utf-8', errors='surrogatepass')
        return path

    return write


@pytest.fixture
def plan(write: Write) -> StudyPlan:
    """The plan of two conditions."""
    return read_plan(write(PLAN))


def keys(plan: StudyPlan, number: int) -> list[str]:
    return [part.key for part in plan.parts_of(number)]


def test_a_participant_goes_through_all_parts_in_the_order_of_the_number(plan: StudyPlan) -> None:
    before = ['consent', 'welcome/1', 'welcome']
    trees, goal = (
        [f'{name}/{part}' for part in ('play', 'buttons', 'teach', 'questions')]
        for name in ('trees', 'goal')
    )
    once = [key for key in trees + goal if not key.endswith('buttons')]  # one game, asked once
    assert keys(plan, 0) == keys(plan, 2) == [*before, *trees, *once[3:]]
    assert keys(plan, 1) == [*before, *goal, *once[:3]]
    parts = plan.parts_of(0)
    assert list(PARTS.validate_json(PARTS.dump_json(tuple(parts)))) == parts


@given(st.integers(1, 8))
def test_each_condition_follows_each_other_equally_often(count: int) -> None:
    square = balanced_latin_square(count)
    assert len(square) == (2 * count if count % 2 and count > 1 else count)
    assert all(sorted(row) == list(range(count)) for row in square)
    places = Counter((place, each) for row in square for place, each in enumerate(row))
    assert (len(places), len(set(places.values()))) == (count * count, 1)
    follows = Counter((a, b) for row in square for a, b in itertools.pairwise(row))
    assert len(follows) == count * (count - 1)
    assert len(set(follows.values())) <= 1


def test_a_random_order_is_that_of_the_seed(write: Write) -> None:
    path = write(PLAN.replace('study:', 'order: random\nstudy:'))
    one, again = read_plan(path), read_plan(path)
    assert [keys(one, n) for n in range(9)] == [keys(again, n) for n in range(9)]
    assert len({tuple(keys(one, n)) for n in range(9)}) == 2


LAKE = 'domain: "gymnasium:FrozenLake-v1", parameters: {is_slippery: "False"}'
CHANGES = [  # what is replaced in the plan, each time by something that cannot be used
    ('study:', ['colour: 1\nstudy:', 'order: any\nstudy:', 'study: a b #', 'study: [']),
    ('study:', ['welcome: x\nstudy:', 'seed: 2026-13-45\nstudy:', 'seed: !!int x\nstudy:']),
    ('study:', ['all: {<<: {}}\nstudy:', 'participants: 3\nstudy:', 'participants: -1\nstudy:']),
    ('name: trees', ['names: trees', 'name: No', 'name: goal', 'name: 1.5', 'name: a b']),
    ('teach: 10', ['tech: 10', 'teach: 0', 'teach: ten', 'teach: yes', 'budget: 0']),
    ('buttons: 3', ['buttons: -1', 'strategy: luck', 'learn: magic']),
    ('domain: taxi', ['domain: pacman', 'domain: chess', 'parameters: {}', LAKE]),
    ('domain: taxi', ['domain: taxi, parameters: {rows: 7.0}']),
    ('nasa-tlx', ['mine.yaml']),
    ('consent.md', ['no.md', '""', '/dev/zero', '"a\\0b"', '']),
    ('conditions:', ['conditions: []\nx:', 'conditions: [1]\nx:']),
]


def test_a_plan_that_cannot_be_carried_out_is_refused_in_one_line_that_says_why(
    write: Write,
) -> None:
    said = []
    for old, news in CHANGES:
        for new in news:
            assert old in PLAN
            path = write(PLAN.replace(old, new, 1))
            with pytest.raises(PlanFileError) as raised:
                read_plan(path)
            line = str(raised.value).replace(str(path.parent), 'DIR')
            assert line.isprintable()
            said.append(f'{json.dumps(new)}\n    {line}')
    snapshot.check('plan_refusals.txt', '\n'.join(said))
    assert read_plan(write(f'participants: 4{PLAN}')).participants == 4


LABELS = 'points: 11\nitems:\n  - {name: 1, text: How hard was it?, low: %s, high: "No"}\n'


def test_labels_are_as_written_and_booleans_are_refused(write: Write) -> None:
    path = write(PLAN.replace('nasa-tlx', 'mine.yaml'))
    for low, shows in {'0': '0', '010': '010', '-5': '-5', '12:30': '12:30', '"No"': 'No'}.items():
        (path.parent / 'mine.yaml').write_text(LABELS % low)
        asked = read_plan(path).parts_of(0)[-1].questions
        question = Question(name='1', text='How hard was it?', low=shows, high='No')
        assert asked == Questionnaire(items=(question,), points=11)
    said = []
    for low in ('No', 'On', '1.50', '', '" "', '[1]', '"\\e[2J"'):
        (path.parent / 'mine.yaml').write_text(LABELS % low)
        with pytest.raises(PlanFileError) as raised:
            read_plan(path)
        said.append(f'{low}\n    {raised.value}')
    snapshot.check('label_refusals.txt', '\n'.join(said))


_YAML = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner),
    max_leaves=5,
)
_KEYS = st.sampled_from(
    [
        *('study', 'consent', 'welcome', 'thanks', 'order', 'participants', 'seed', 'all'),
        *('conditions', 'name', 'domain', 'parameters', 'learn', 'strategy', 'budget', 'page'),
        *('free_play', 'buttons', 'teach', 'questions', '<<'),
    ]
)
_WORDS = st.sampled_from(
    ['a', 'taxi', 'rooms', 'gymnasium:FrozenLake-v1', 'consent.md', '/dev/zero', 'nasa-tlx', '\0']
)
_CONDITIONS = st.lists(
    st.fixed_dictionaries({'name': _WORDS | _YAML, 'domain': _WORDS}), max_size=4
)
_PLANS = st.dictionaries(_KEYS, _WORDS | _YAML | _CONDITIONS).map(yaml.safe_dump)


@given(
    st.tuples(_PLANS, st.integers(0, 200), st.text(max_size=9)).map(
        lambda each: each[0][: each[1]] + each[2] + each[0][each[1] :]
    )
    | st.tuples(_PLANS, _CONDITIONS).map(
        lambda each: f'{each[0]}\n{yaml.safe_dump({"conditions": each[1]})}'
    )
)
@settings(
    max_examples=int(os.environ.get('GENERATED', '200')),
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
def test_any_plan_is_read_or_refused_in_one_line_at_once(write: Write, text: str) -> None:
    path, began, said = write(text), time.process_time(), ''
    try:
        read_plan(path)
    except PlanFileError as error:
        said = str(error)
    assert said.isprintable()
    assert len(said) < 1000
    assert time.process_time() - began < 1


def test_a_code_is_used_once_and_goes_on_until_its_end(plan: StudyPlan, tmp_path: Path) -> None:
    folder = StudyFolder(tmp_path / 'study')
    two = plan.model_copy(update={'participants': 2})
    anna = folder.enter(two, 'anna')
    assert (anna.number, folder.enter(two, 'ben').number) == (0, 1)
    assert folder.enter(two, 'anna').path == anna.path
    said = []
    for code, simulated in (('carl', False), ('../x', False), ('ben', True), ('ANNA', False)):
        with pytest.raises(StudyError) as raised:
            folder.enter(two, code, simulated=simulated)
        said.append(str(raised.value))
    OpenRecord(anna.path).note('ended')
    with pytest.raises(StudyError) as raised:
        folder.enter(two, 'anna')
    snapshot.check('code_refusals.txt', '\n'.join([*said, str(raised.value)]))


def test_a_changed_plan_is_refused_with_the_difference_or_accepted_and_kept(
    write: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write(PLAN)
    place = [str(path), '--study', str(tmp_path / 'study')]
    folder, plan = StudyFolder(tmp_path / 'study'), read_plan(path)
    folder.enter(plan, 'anna'), folder.enter(plan, 'ben')
    record = folder.records()[0][0].path.read_bytes()

    def status() -> list[dict[str, Any]]:
        assert main(['study', 'status', *place, '--json']) == 0
        found: list[dict[str, Any]] = json.loads(capsys.readouterr().out)
        return found

    before = status()
    assert [row['order'] for row in before] == ['trees, goal', 'goal, trees']
    swapped = PLAN.replace('{name: trees}', '{name: trees, learn: goal}').replace(
        '{name: goal, learn: goal}', '{name: goal}'
    )
    third = f'{swapped}  - {{name: third}}\n'
    for text in (swapped, third, PLAN.replace('teach: 10', 'teach: 9'), 'study: [', PLAN):
        write(text)
        if text == PLAN:
            (tmp_path / 'welcome.md').write_text('First.\n\n---\n\nAnother.\n')
        refused = main(['study', *place, '--participant', 'anna'])
        errors = capsys.readouterr().err
        assert refused == 2
        if text != 'study: [':
            assert 'accept the change with --accept-changes' in errors.splitlines()[-1]
        assert status() == before  # what was kept, whatever the file says now
    assert {'-    "Second.",', '+    "Another.",'} <= {line.strip() for line in errors.split('\n')}
    assert folder.records()[0][0].path.read_bytes() == record
    (tmp_path / 'welcome.md').write_text('First.\n\n---\n\nSecond.\n')
    write(third)
    assert main(['study', *place, '--accept-changes', '--participant', 'anna']) == 2
    said = capsys.readouterr()
    assert 'The changed plan is kept' in said.out
    assert 'needs a terminal' in said.err
    first, changed = Protocol(folder.path).versions
    assert (changed.event, changed.replaces) == ('protocol changed', first.digest)
    assert '+   "name": "third",' in changed.diff
    assert status() == before
    anna = folder.enter(changed.plan, 'anna')  # goes on with what she began
    assert folder.plan_of(changed.plan, anna) == first.plan == plan
    carl = folder.enter(changed.plan, 'carl')
    assert folder.plan_of(plan, carl) == changed.plan == read_plan(path)
    assert status()[2]['order'].count(',') == 2
    assert main(['study', 'export', *place]) == 0
    versions = json.loads((tmp_path / 'study' / 'tables' / 'protocol.json').read_text())
    assert [each['digest'] for each in versions] == [first.digest, changed.digest]
    kept = tmp_path / 'study' / 'protocol.jsonl'
    kept.write_text(kept.read_text().replace('Second', 'Third', 1))
    capsys.readouterr()
    assert main(['study', *place]) == 2
    assert 'line 1' in (error := capsys.readouterr().err)
    assert 'put the file back from a copy' in error
    for spoil in (kept.unlink, kept.touch):  # lost, or emptied
        spoil()
        for command in ([], ['--accept-changes'], ['status']):
            code = main(['study', *command[:1], *place] if 'status' in command else
                        ['study', *place, *command])  # fmt: skip
            assert code == (0 if 'status' in command else 2)
            lost = f"does not hold the plan {first.digest[:12]}, which 'anna' follows"
            assert lost in capsys.readouterr().err


def test_a_maze_in_a_file_is_part_of_the_plan(
    write: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    maze, yard = tmp_path / 'own.lay', load_maze('yard').text
    maze.write_text(yard)
    games = PLAN.replace('taxi', f"pacman, parameters: {{maze: '{maze}', ghosts: chase}}")
    path = write(games.replace(', learn: goal', ''))
    StudyFolder(tmp_path / 'study').enter(plan := read_plan(path), 'anna')
    assert plan.conditions[0].parameters == {'maze': yard, 'ghosts': 'chase'}
    maze.write_text(yard.replace('.', ' ', 1))
    assert main(['study', str(path), '--study', str(tmp_path / 'study')]) == 2
    said = capsys.readouterr().err
    assert 'accept the change with --accept-changes' in said
    assert said.count(f'\n-     "{yard.splitlines()[1]}",') == 2  # in each condition


LIKED = Question(name='liked', text='Did you like it?', low='not at all', high='very much')
CONSENT = Part(kind=PartKind.CONSENT, key='consent', text='# Taking part\nYou can *stop*.')
PAGE = Part(kind=PartKind.PAGE, key='page', text='Read this.')
IN = {'condition': 'a', 'domain': 'taxi'}
PLAY = Part(kind=PartKind.PLAY, key='a/play', minutes=2.0, **IN)  # type: ignore[arg-type]
BUTTONS = Part(kind=PartKind.BUTTONS, key='a/buttons', most=2, **IN)  # type: ignore[arg-type]
TEACH = Part(kind=PartKind.TEACH, key='a/teach', minutes=10.0, **IN)  # type: ignore[arg-type]
QUESTIONS = Part(
    kind=PartKind.QUESTIONS,
    key='a/questions',
    questions=Questionnaire(items=(LIKED, LIKED.model_copy(update={'name': 'again'})), points=5),
)


class Guest:
    """Takes part: presses keys, and answers requests as a graph would."""

    def __init__(self, parts: list[Part], record: Path, domain: Domain[Any], now: float = 0.0):
        self.published: list[str] = []
        self.now, self.record = now, OpenRecord(record, self.published.append, lambda: self.now)
        self.world = World(domain=domain, me='me')
        self.world.game = Transition(episode=1, step=0, state=START)
        self.world.lesson = LessonView(Phase.NO_SESSION, budget=100)
        self.app = StudyApp(parts, self.record, 'anna', self.world, seed=1)
        self.look()

    def look(self, now: float | None = None) -> None:
        """Let two turns pass."""
        self.now = self.now if now is None else now
        self.app.advance(self.now), self.app.advance(self.now)

    def press(self, *typed: str) -> None:
        """Look, and press keys one after the other."""
        for key in typed:
            self.app.drawn()
            self.app.type([key])
            self.look()

    def lesson(self, phase: Phase, participant: str = 'anna', **fields: Any) -> None:
        """Have the lesson announce where it is; answer the request that waits for it."""
        self.world.lesson = LessonView(phase, participant, 's', budget=100, **fields)
        if (asked := self.app.waits_for) is not None:
            self.app.replied(asked, Answer(RequestStatus.OK, ''), self.now)
        self.look()

    def sees(self, text: str) -> bool:
        return text in '\n'.join(frame(self.app, 100, 30))

    def events(self, what: str) -> list[tuple[Any, ...]]:
        """Return the events of a kind, without time and condition."""
        dumped = (
            event.model_dump(mode='json', exclude_unset=True) for event in self.record.events
        )
        left = ('time', 'event', 'condition')
        return [
            tuple(value for key, value in sorted(values.items()) if key not in left)
            for values in dumped
            if values['event'] == what
        ]


def test_who_agrees_goes_on_and_who_does_not_is_asked_nothing_more(
    tmp_path: Path, taxi: Domain[Any]
) -> None:
    agreeing = Guest([CONSENT, PAGE], tmp_path / 'a.jsonl', taxi)
    assert agreeing.sees('You can stop.')
    agreeing.press('enter')
    assert agreeing.events('part ended') == []
    agreeing.press('y', 'ctrl-c')
    assert agreeing.app.ended
    left = OpenRecord(tmp_path / 'a.jsonl').left_of([CONSENT, PAGE])
    again = Guest(left, tmp_path / 'a.jsonl', taxi)
    assert again.sees('Read this.')
    again.press('enter')
    assert again.app.ended
    ended = [('consent', 'consent', 'finished'), ('page', 'page', 'finished')]
    assert again.events('part ended') == ended
    kept = (tmp_path / 'a.jsonl').read_text().splitlines()
    assert agreeing.published + again.published == kept  # as they are kept
    refusing = Guest([CONSENT, PAGE], tmp_path / 'b.jsonl', taxi)
    refusing.press('n')
    assert refusing.app.ended
    assert refusing.record.refused
    assert refusing.events('part began') == [('consent', 'consent')]


def test_free_play_ends_by_the_person_or_by_its_time(tmp_path: Path, taxi: Domain[Any]) -> None:
    guest, slow = (Guest([PLAY, PAGE], tmp_path / f'{n}.jsonl', taxi) for n in range(2))
    guest.press('escape')
    assert guest.sees('Read this.')
    slow.look(119.9)
    assert slow.sees('Get to know the game')
    slow.look(120.0)
    assert slow.sees('Read this.')
    assert slow.events('part ended') == [('play', 'a/play', 'time is over')]


def taught_for(
    path: Path, taxi: Domain[Any], start: float, seconds: float, *, crash: bool = False
) -> Guest:
    """Teach in one sitting, looking each second, and leave; a crash leaves no word."""
    guest = Guest([TEACH, PAGE], path, taxi, start)
    while guest.now < start + seconds and not guest.sees('Read this.'):
        guest.now += 1.0
        guest.world.summaries = [OptionSummary('fetch', 'anna', n_demonstrations=1)]
        guest.app.advance(guest.now)
    if not crash:
        guest.app.last_requests()
    return guest


def test_the_time_of_teaching_goes_on_where_it_was_left(tmp_path: Path, taxi: Domain[Any]) -> None:
    path = tmp_path / 'a.jsonl'
    taught_for(path, taxi, 1000.0, 250.0)
    crashed = taught_for(path, taxi, 2000.0, 209.0, crash=True)  # its last sign is of second 205
    assert crashed.events('part ended') == []
    last = taught_for(path, taxi, 3000.0, 600.0)
    assert last.events('part ended') == [('teach', 'a/teach', 'time is over')]
    assert OpenRecord(path).seconds_in('a/teach') == pytest.approx(600.0, abs=1.0)
    assert last.now == pytest.approx(3000.0 + 600.0 - 250.0 - 205.0, abs=2.0)
    assert len(last.events('learned')) == 3  # one for each sitting


def test_buttons_and_answers_are_kept_as_they_are_given(tmp_path: Path, taxi: Domain[Any]) -> None:
    guest = Guest([BUTTONS, QUESTIONS, PAGE], tmp_path / 'a.jsonl', taxi)
    guest.press(*'fetch', 'enter')
    assert guest.sees('Button 2 of at most 2')
    guest.press(*'go', 'enter')
    guest.press('enter')  # nothing is chosen yet
    guest.press(*['right'] * 9, 'enter')
    assert guest.sees('question 2 of 2')
    guest.press('left', 'left', '9', 'enter')  # 9 is not on a scale of 5
    assert guest.sees('Read this.')
    buttons = [('taxi', 'a/buttons', 1, 'fetch'), ('taxi', 'a/buttons', 2, 'go')]
    assert guest.events('button') == buttons
    answers = [('liked', 'a/questions', 5, 5), ('again', 'a/questions', 5, 2)]
    assert guest.events('answer') == answers
    fewer = Guest([BUTTONS, PAGE], tmp_path / 'b.jsonl', taxi)
    fewer.press('escape')
    assert fewer.sees('Read this.')


def test_teaching_ends_from_the_menu_and_never_in_a_demonstration(
    tmp_path: Path, taxi: Domain[Any]
) -> None:
    guest = Guest([TEACH, PAGE], tmp_path / 'a.jsonl', taxi)
    guest.lesson(Phase.NO_OPTION)
    assert guest.sees('Finish teaching  continue with the study')
    guest.lesson(Phase.DEMONSTRATING)
    guest.look(601.0)
    assert guest.sees('this demonstration is the last')
    guest.lesson(Phase.LEARNING)
    assert guest.sees('Read this.')
    assert guest.events('part ended') == [('teach', 'a/teach', 'time is over')]


def test_teaching_that_somebody_else_has_taken_over_ends_without_a_word_to_their_lesson(
    tmp_path: Path, taxi: Domain[Any]
) -> None:
    guest = Guest([TEACH, PAGE], tmp_path / 'a.jsonl', taxi)
    guest.lesson(Phase.NO_OPTION)
    guest.press('1', *'fetch', 'enter')
    guest.lesson(Phase.DEMONSTRATING, option_name='fetch', episode=1)
    guest.lesson(Phase.DEMONSTRATING, 'bob', option_name='go', episode=2)
    guest.press('q')
    assert guest.app.waits_for is None
    assert guest.sees('Read this.')
    assert not guest.sees('bob')


def test_a_simulated_study_makes_tables_that_the_codebook_explains(
    plan: StudyPlan, tmp_path: Path
) -> None:
    folder = StudyFolder(tmp_path / 'study')
    option = OptionSummary('fetch', 's', n_demonstrations=4)
    for code in ('s1', 's2'):
        who = folder.enter(plan, code, simulated=True)
        record = OpenRecord(who.path)
        for part in plan.parts_of(who.number):
            simulated_part(part, record, plan.seed, who.number, lambda: [option])
        record.note('ended')
    folder.enter(plan, 'late')
    records, problems = folder.records()
    assert problems == []
    found = tables(records)
    for name, columns in CODEBOOK.items():
        assert list(found[name].columns) == list(columns)
    book = found['codebook.csv']
    assert len(book) == sum(map(len, CODEBOOK.values()))
    assert book['meaning'].all()
    taught = found['options.csv']
    assert list(taught['participant']) == ['s1', 's1', 's2', 's2']
    assert set(taught['demonstrations']) == {4}
    assert taught['return_shown'].isna().all()  # not measured
    people = found['participants.csv'][['participant', 'order', 'ended', 'simulated']]
    assert people.to_numpy().tolist() == [
        ['s1', 'trees goal', 'yes', 'yes'],
        ['s2', 'goal trees', 'yes', 'yes'],
        ['late', 'trees goal', 'no', 'no'],
    ]
    answers = found['answers.csv']
    assert len(answers) == 2 * 2 * 6
    assert answers['value'].between(1, 21).all()
    parts = found['parts.csv']
    places = parts[parts['part'] == 'teach'][['participant', 'condition', 'place']]
    assert places.to_numpy().tolist() == [
        ['s1', 'trees', 1], ['s1', 'goal', 2], ['s2', 'goal', 1], ['s2', 'trees', 2],
    ]  # fmt: skip
    status = status_table(Protocol(folder.path), records).set_index('participant')
    assert status['next'].to_dict() == {'s1': '-', 's2': '-', 'late': 'consent'}
