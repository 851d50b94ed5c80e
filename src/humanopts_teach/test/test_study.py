"""Studies: the plan and its orders, what is kept, the dialogue, and the tables."""

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
from humanopts_teach.lesson.requests import (
    Answer,
    LessonView,
    OpenSession,
    Phase,
    Request,
    RequestStatus,
    World,
)
from humanopts_teach.study.events import ParticipantEnded
from humanopts_teach.study.plan import (
    balanced_latin_square,
    Kind,
    Part,
    parts_from_json,
    parts_to_json,
    PlanFileError,
    Question,
    read_plan,
    StudyPlan,
)
from humanopts_teach.study.record import OpenRecord, StudyError, StudyFolder
from humanopts_teach.study.tables import CODEBOOK, status_table, tables
from humanopts_teach.terminal.drawing import frame
from hypothesis import given, HealthCheck, settings
from hypothesis import strategies as st
import pytest
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
LIKERT = Question('liked', 'Did you like it?', 'not at all', 'very much', points=5)


@pytest.fixture
def write(tmp_path: Path) -> Callable[[str], Path]:
    """Write a plan beside its pages."""
    (tmp_path / 'consent.md').write_text('# Taking part\nYou can stop.\n')
    (tmp_path / 'welcome.md').write_text('First.\n\n---\n\nSecond.\n')

    def write(text: str) -> Path:
        path = tmp_path / 'plan.yaml'
        path.write_text(text)
        return path

    return write


@pytest.fixture
def plan(write: Callable[[str], Path]) -> StudyPlan:
    """The plan of two conditions."""
    return read_plan(write(PLAN))


def keys(plan: StudyPlan, number: int) -> list[str]:
    """Return the keys of a participant's parts, in order."""
    return [part.key for part in plan.parts_of(number)]


def test_a_participant_goes_through_all_parts_in_the_order_of_the_number(plan: StudyPlan) -> None:
    before = ['consent', 'welcome/1', 'welcome']
    trees, goal = (
        [f'{name}/{part}' for part in ('play', 'buttons', 'teach', 'questions')]
        for name in ('trees', 'goal')
    )
    trees_again = [key for key in trees if key != 'trees/buttons']
    goal_again = [key for key in goal if key != 'goal/buttons']  # one game: they are asked once
    assert keys(plan, 0) == [*before, *trees, *goal_again]
    assert keys(plan, 1) == [*before, *goal, *trees_again]
    assert keys(plan, 2) == keys(plan, 0)


@given(st.integers(1, 8))
def test_each_condition_follows_each_other_equally_often(count: int) -> None:
    square = balanced_latin_square(count)
    assert len(square) == (2 * count if count % 2 and count > 1 else count)
    assert all(sorted(row) == list(range(count)) for row in square)
    places = Counter((place, each) for row in square for place, each in enumerate(row))
    assert len(places) == count * count
    assert len(set(places.values())) == 1
    follows = Counter((a, b) for row in square for a, b in itertools.pairwise(row))
    assert len(follows) == count * (count - 1)
    assert len(set(follows.values())) <= 1


def test_a_random_order_is_that_of_the_seed(write: Callable[[str], Path]) -> None:
    text = PLAN.replace('study:', 'order: random\nstudy:')
    one, again = read_plan(write(text)), read_plan(write(text))
    assert [keys(one, n) for n in range(9)] == [keys(again, n) for n in range(9)]
    assert len({tuple(keys(one, n)) for n in range(9)}) == 2


@pytest.mark.parametrize(
    ('old', 'new', 'why'),
    [
        pytest.param('study:', 'colour: 1\nstudy:', 'unknown keys: colour', id='unknown'),
        pytest.param('name: trees', 'names: trees', 'condition 1 has no name', id='name'),
        pytest.param('teach: 10', 'tech: 10', 'unknown keys: tech', id='unknown in condition'),
        pytest.param('teach: 10', 'teach: 0', 'has to be above 0 minutes', id='no time'),
        pytest.param('teach: 10', 'teach: ten', 'has to be minutes', id='no number'),
        pytest.param('buttons: 3', 'buttons: -1', 'a whole number from 0 on', id='negative'),
        pytest.param('name: goal,', 'name: trees,', 'the same name', id='same name'),
        pytest.param('learn: goal', 'learn: magic', "'magic' is no way to learn", id='no method'),
        pytest.param('domain: taxi', 'domain: pacman', 'cannot be listed', id='goal in Pac-Man'),
        pytest.param('domain: taxi', 'domain: chess', "'chess'", id='no domain'),
        pytest.param('nasa-tlx', 'mine.yaml', 'cannot read', id='no questions'),
        pytest.param('consent.md', 'no.md', 'cannot read', id='no page'),
        pytest.param('study:', 'order: any\nstudy:', 'it is one of fixed', id='no order'),
        pytest.param('study: ', 'study: a b', 'letters, digits', id='study'),
        pytest.param('conditions:', 'conditions: []\nx:', 'unknown keys: x', id='list and more'),
        pytest.param('study:', 'study: [', 'is not YAML', id='yaml'),
        pytest.param('study:', 'welcome: x\nstudy:', "'welcome' is there twice", id='twice'),
        pytest.param('consent: consent.md', 'consent:', 'consent of the plan is null', id='null'),
        pytest.param('consent.md', '""', 'consent of the plan is empty', id='empty'),
        pytest.param('consent.md', '/dev/zero', 'not a regular file', id='device'),
        pytest.param('consent.md', '"a\\0b"', 'characters that control terminals', id='NUL'),
        pytest.param('name: trees', 'name: No', 'is false, as YAML reads words', id='boolean'),
        pytest.param('domain: taxi', 'parameters: {}', 'trees has no domain', id='lacks domain'),
        pytest.param('teach: 10', 'teach: yes', 'teach of condition trees is true', id='minutes'),
        pytest.param('study:', 'seed: 2026-13-45\nstudy:', 'is "2026-13-45"; it has', id='date'),
        pytest.param('study:', 'seed: !!int x\nstudy:', 'remove tags', id='tag'),
        pytest.param('study:', 'all: {<<: {}}\nstudy:', 'merge keys', id='merge'),
        pytest.param(
            'teach: 10', 'budget: 0', 'budget of condition trees has to be 1', id='budget'
        ),
        pytest.param(
            'domain: taxi',
            'domain: "gymnasium:FrozenLake-v1", parameters: {is_slippery: "False"}',
            'is "False", and has to be true or false',
            id='text for a boolean',
        ),
        pytest.param(
            'domain: taxi',
            'domain: taxi, parameters: {rows: 7.0}',
            'rows of taxi is 7.0, and has to be a whole number',
            id='fraction for a whole number',
        ),
    ],
)
def test_a_plan_that_cannot_be_carried_out_is_refused(
    write: Callable[[str], Path], old: str, new: str, why: str
) -> None:
    assert old in PLAN
    with pytest.raises(PlanFileError) as raised:
        read_plan(write(PLAN.replace(old, new)))
    assert why in str(raised.value)
    assert str(raised.value).isprintable()


LABELS = """
points: 11
items:
  - {name: 1, text: How hard was it?, low: %s, high: "No"}
"""


def test_labels_are_as_written_and_booleans_are_refused(write: Callable[[str], Path]) -> None:
    path = write(PLAN.replace('nasa-tlx', 'mine.yaml'))
    for low, shows in {'0': '0', '010': '010', '-5': '-5', '12:30': '12:30', '"No"': 'No'}.items():
        (path.parent / 'mine.yaml').write_text(LABELS % low)
        asked = read_plan(path).during['trees'][-1].questions
        assert asked == (Question('1', 'How hard was it?', shows, 'No', points=11),)
    for low, why in {
        'No': 'is false, as YAML reads words such as No and Yes: put it in quotes',
        'On': 'is true, as YAML reads words such as No and Yes: put it in quotes',
        '1.50': 'is 1.5; it has to be a text: put it in quotes',
        '': 'is null; it has to be a text',
        '" "': 'is empty',
        '[1]': 'is [1]; it has to be a text',
        '"\\e[2J"': 'has characters that control terminals',
    }.items():
        (path.parent / 'mine.yaml').write_text(LABELS % low)
        with pytest.raises(PlanFileError) as raised:
            read_plan(path)
        assert f'low of item 1 of mine.yaml {why}' in str(raised.value)


def test_parts_come_back_from_their_json(plan: StudyPlan) -> None:
    parts = plan.parts_of(0)
    assert list(parts_from_json(parts_to_json(parts))) == parts


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
_VALUES = _WORDS | _YAML
_CONDITION = st.dictionaries(_KEYS, _VALUES | st.dictionaries(_KEYS, _VALUES), max_size=6)
_PLANS = st.fixed_dictionaries(
    {
        'conditions': st.lists(
            st.fixed_dictionaries({'name': _VALUES, 'domain': _WORDS}), max_size=4
        )
    },
    optional={
        'all': _CONDITION,
        'study': _VALUES,
        'consent': _VALUES,
        'order': _VALUES,
        'participants': _VALUES,
        'seed': _VALUES,
    },
)


@given(
    _PLANS.map(yaml.safe_dump)
    | st.dictionaries(_KEYS, _VALUES).map(yaml.safe_dump)
    | st.tuples(_PLANS.map(yaml.safe_dump), st.integers(0, 200), st.text(max_size=9)).map(
        lambda each: each[0][: each[1]] + each[2] + each[0][each[1] :]
    )
)
@settings(
    max_examples=int(os.environ.get('GENERATED', '200')),
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
def test_any_plan_is_read_or_refused_in_one_line_at_once(
    write: Callable[[str], Path], text: str
) -> None:
    path = write(PLAN)
    path.write_text(text, encoding='utf-8', errors='surrogatepass')
    began = time.process_time()
    try:
        read_plan(path)
    except PlanFileError as error:
        said = str(error)
    else:
        said = ''
    assert said.isprintable()
    assert len(said) < 1000
    assert time.process_time() - began < 1


def test_orders_that_cannot_be_balanced_are_refused(write: Callable[[str], Path]) -> None:
    with pytest.raises(PlanFileError, match=r'3 participants cannot .* plan for 2 or 4'):
        read_plan(write('participants: 3' + PLAN))
    assert read_plan(write('participants: 4' + PLAN)).participants == 4


def test_a_code_is_used_once_and_goes_on_until_its_end(plan: StudyPlan, tmp_path: Path) -> None:
    folder = StudyFolder(tmp_path / 'study')
    anna = folder.enter(plan, 'anna')
    assert (anna.number, folder.enter(plan, 'ben').number) == (0, 1)
    assert folder.enter(plan, 'anna') == anna
    OpenRecord(anna.path).note(ParticipantEnded)
    with pytest.raises(StudyError, match="'anna' has ended this study already"):
        folder.enter(plan, 'anna')
    with pytest.raises(StudyError, match='not a code'):
        folder.enter(plan, '../x')
    folder.enter(plan, 'simulated-1')
    with pytest.raises(StudyError, match="'simulated-1' is a person of this study"):
        folder.enter(plan, 'simulated-1', simulated=True)


def test_too_many_people_are_refused(write: Callable[[str], Path], tmp_path: Path) -> None:
    folder = StudyFolder(tmp_path / 'study')
    two = read_plan(write('participants: 2' + PLAN))
    folder.enter(two, 'anna'), folder.enter(two, 'ben')
    with pytest.raises(StudyError, match=r"all 2 participants .* 'carl' is new"):
        folder.enter(two, 'carl')


def test_a_changed_plan_is_refused_with_the_difference_or_accepted_and_kept(
    write: Callable[[str], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write(PLAN)
    place = [str(path), '--study', str(tmp_path / 'study')]
    folder, plan = StudyFolder(tmp_path / 'study'), read_plan(path)
    folder.enter(plan, 'anna'), folder.enter(plan, 'ben')
    record = folder.participants()[0][0].path.read_bytes()

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
    assert '-    "Second.",' in errors
    assert '+    "Another.",' in errors
    assert folder.participants()[0][0].path.read_bytes() == record
    (tmp_path / 'welcome.md').write_text('First.\n\n---\n\nSecond.\n')
    write(third)
    assert main(['study', *place, '--accept-changes', '--participant', 'anna']) == 2
    said = capsys.readouterr()
    assert 'The changed plan is kept' in said.out
    assert 'needs a terminal' in said.err
    first, changed = folder.protocol().versions
    assert (changed.event, changed.replaces) == ('protocol changed', first.digest)
    assert '+   "name": "third",' in changed.diff
    assert changed.time >= first.time
    assert status() == before
    anna, _ = folder.participants()[0]
    assert folder.plan_of(changed.plan, anna) == first.plan == plan
    assert folder.enter(changed.plan, 'anna') == anna  # goes on with what she began
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
        assert main(['study', *place]) == main(['study', *place, '--accept-changes']) == 2
        assert f"does not hold the plan {first.digest[:12]}, which 'anna' follows" in (
            capsys.readouterr().err
        )
        assert main(['study', 'status', *place]) == 0
        assert 'does not hold the plan' in capsys.readouterr().err


def test_a_maze_in_a_file_is_part_of_the_plan(
    write: Callable[[str], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    maze = tmp_path / 'own.lay'
    maze.write_text(load_maze('yard').text)
    games = PLAN.replace('taxi', f"pacman, parameters: {{maze: '{maze}', ghosts: chase}}")
    path = write(games.replace(', learn: goal', ''))
    StudyFolder(tmp_path / 'study').enter(plan := read_plan(path), 'anna')
    assert plan.conditions[0].parameters == {'maze': load_maze('yard').text, 'ghosts': 'chase'}
    first = load_maze('yard').text.split('\n')[1]
    maze.write_text(load_maze('yard').text.replace('.', ' ', 1))
    capsys.readouterr()
    assert main(['study', str(path), '--study', str(tmp_path / 'study')]) == 2
    said = capsys.readouterr().err
    assert 'accept the change with --accept-changes' in said
    assert said.count(f'\n-     "{first}",') == 2  # of the maze, in each condition


class Guest:
    """Takes part: presses keys, and answers requests as a graph would."""

    def __init__(
        self, parts: list[Part], record: Path, domain: Domain[Any], now: float = 0.0
    ) -> None:
        self.published: list[str] = []
        self.now, self.record = now, OpenRecord(record, self.published.append, lambda: self.now)
        self.world = World()
        self.world.domain, self.world.me = domain, 'me'
        self.world.game = Transition(episode=1, step=0, state=START)
        self.world.lesson = LessonView(Phase.NO_SESSION, budget=100)
        self.app = StudyApp(parts, self.record, 'anna', self.world, seed=1)
        self.look()

    def look(self) -> Request | None:
        return self.app.advance(self.now)

    def press(self, *typed: str) -> Request | None:
        """Look, press keys one after the other, and return the last request."""
        request = None
        for key in typed:
            self.app.drawn()
            self.app.type([key])
            request = self.look()
            self.look()
        return request

    @property
    def seen(self) -> str:
        """What the terminal shows."""
        return '\n'.join(frame(self.app, 100, 30))

    def events(self, what: str) -> list[tuple[Any, ...]]:
        """Return the events of a kind, without the time."""
        left = ('time', 'event', 'condition')
        return [
            tuple(value for key, value in sorted(values.items()) if key not in left)
            for values in (event.model_dump(mode='json') for event in self.record.events)
            if values['event'] == what
        ]


CONSENT = Part(Kind.CONSENT, 'consent', text='# Taking part\nYou can *stop*.')
PAGE = Part(Kind.PAGE, 'page', text='Read this.')
PLAY = Part(Kind.PLAY, 'a/play', 'a', 'taxi', minutes=2.0)
BUTTONS = Part(Kind.BUTTONS, 'a/buttons', 'a', 'taxi', most=2)
TEACH = Part(Kind.TEACH, 'a/teach', 'a', 'taxi', minutes=10.0)
QUESTIONS = Part(Kind.QUESTIONS, 'a/questions', 'a', 'taxi', questions=(LIKERT, LIKERT))


def test_who_agrees_goes_on_and_who_does_not_is_asked_nothing_more(
    tmp_path: Path, taxi: Domain[Any]
) -> None:
    agreeing = Guest([CONSENT, PAGE], tmp_path / 'a.jsonl', taxi)
    assert 'You can stop.' in agreeing.seen
    assert 'landmarks' not in agreeing.seen
    agreeing.press('enter')
    assert agreeing.events('part ended') == []
    agreeing.press('y')
    assert 'Read this.' in agreeing.seen
    assert not agreeing.app.ended
    agreeing.press('enter')
    assert agreeing.app.ended
    assert agreeing.events('part ended') == [
        ('consent', 'consent', 'finished'),
        ('page', 'page', 'finished'),
    ]
    refusing = Guest([CONSENT, PAGE], tmp_path / 'b.jsonl', taxi)
    refusing.press('n')
    assert refusing.app.ended
    assert refusing.record.refused
    assert refusing.events('part began') == [('consent', 'consent')]


def test_free_play_ends_by_the_person_or_by_its_time(tmp_path: Path, taxi: Domain[Any]) -> None:
    guest = Guest([PLAY, PAGE], tmp_path / 'a.jsonl', taxi)
    assert 'Get to know the game' in guest.seen
    guest.press('escape')
    assert 'Read this.' in guest.seen
    slow = Guest([PLAY, PAGE], tmp_path / 'b.jsonl', taxi)
    slow.now = 119.9
    slow.look()
    assert 'Get to know the game' in slow.seen
    slow.now = 120.0
    slow.look()
    slow.look()
    assert 'Read this.' in slow.seen
    assert slow.events('part ended') == [('play', 'a/play', 'time is over')]


def taught_for(
    path: Path, taxi: Domain[Any], start: float, seconds: float, *, crash: bool = False
) -> Guest:
    """Teach in one sitting, looking each second, and leave; a crash leaves no word."""
    guest = Guest([TEACH, PAGE], path, taxi, start)
    option = OptionSummary('fetch', 'anna', n_demonstrations=1)
    while guest.now < start + seconds and 'Read this.' not in guest.seen:
        guest.now += 1.0
        guest.world.summaries = [option]
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


def test_buttons_are_kept_as_they_are_typed(tmp_path: Path, taxi: Domain[Any]) -> None:
    guest = Guest([BUTTONS, PAGE], tmp_path / 'a.jsonl', taxi)
    guest.press(*'fetch', 'enter')
    assert 'Button 2 of at most 2' in guest.seen
    guest.press(*'go', 'enter')
    assert 'Read this.' in guest.seen
    fewer = Guest([BUTTONS, PAGE], tmp_path / 'b.jsonl', taxi)
    fewer.press('escape')
    assert 'Read this.' in fewer.seen
    assert guest.events('button') == [
        ('taxi', 'a/buttons', 1, 'fetch'),
        ('taxi', 'a/buttons', 2, 'go'),
    ]
    assert fewer.events('button') == []


def test_questions_are_answered_on_their_scale(tmp_path: Path, taxi: Domain[Any]) -> None:
    guest = Guest([QUESTIONS], tmp_path / 'a.jsonl', taxi)
    guest.press('enter')  # nothing is chosen yet
    guest.press(*['right'] * 9, 'enter')
    assert 'question 2 of 2' in guest.seen
    guest.press('left', 'left', '9', 'enter')  # 9 is not on a scale of 5
    assert guest.app.ended
    assert guest.events('answer') == [
        ('liked', 'a/questions', 5, 5),
        ('liked', 'a/questions', 5, 2),
    ]


def test_teaching_ends_from_the_menu_and_never_in_a_demonstration(
    tmp_path: Path, taxi: Domain[Any]
) -> None:
    guest = Guest([TEACH, PAGE], tmp_path / 'a.jsonl', taxi)
    opened = guest.app.waits_for
    assert opened == OpenSession('anna')
    guest.world.lesson = LessonView(Phase.NO_OPTION, 'anna', 's', budget=100)
    guest.app.replied(opened, Answer(RequestStatus.OK, ''), guest.now)
    assert 'Finish teaching  go on with the study' in guest.seen
    guest.world.lesson = LessonView(Phase.DEMONSTRATING, participant='anna', budget=100)
    guest.now = 601.0
    guest.look()
    assert 'this demonstration is the last' in guest.seen
    guest.world.lesson = LessonView(Phase.LEARNING, participant='anna', budget=100)
    guest.look()
    guest.look()
    assert 'Read this.' in guest.seen
    assert guest.events('part ended') == [('teach', 'a/teach', 'time is over')]


def test_teaching_that_somebody_else_has_taken_over_ends_without_a_word_to_their_lesson(
    tmp_path: Path, taxi: Domain[Any]
) -> None:
    guest = Guest([TEACH, PAGE], tmp_path / 'a.jsonl', taxi)
    opened = guest.app.waits_for
    assert opened is not None
    guest.world.lesson = LessonView(Phase.NO_OPTION, 'anna', 's', budget=100)
    guest.app.replied(opened, Answer(RequestStatus.OK, ''), guest.now)
    guest.press('1', *'fetch')
    defined = guest.press('enter')
    assert defined is not None
    guest.world.lesson = LessonView(Phase.DEMONSTRATING, 'anna', 's', 'fetch', episode=1)
    guest.app.replied(defined, Answer(RequestStatus.OK, ''), guest.now)
    guest.look()
    guest.world.lesson = LessonView(Phase.DEMONSTRATING, 'bob', 't', 'go', episode=2)
    assert guest.press('q') is None
    assert 'Read this.' in guest.seen
    assert 'bob' not in guest.seen


def test_ctrl_c_leaves_a_part_that_is_begun_again(tmp_path: Path, taxi: Domain[Any]) -> None:
    path = tmp_path / 'a.jsonl'
    guest = Guest([CONSENT, PAGE], path, taxi)
    guest.press('y', 'ctrl-c')
    assert guest.app.ended
    again = Guest(
        [part for part in (CONSENT, PAGE) if part.key not in OpenRecord(path).done], path, taxi
    )
    assert 'Read this.' in again.seen


def test_every_event_is_published_as_it_is_kept(tmp_path: Path, taxi: Domain[Any]) -> None:
    path = tmp_path / 'a.jsonl'
    guest = Guest([CONSENT], path, taxi)
    guest.press('y')
    assert guest.published == path.read_text().splitlines()


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
        record.note(ParticipantEnded)
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
    people = found['participants.csv'].set_index('participant')
    assert people['order'].to_dict() == {
        's1': 'trees goal',
        's2': 'goal trees',
        'late': 'trees goal',
    }
    assert people['ended'].to_dict() == {'s1': 'yes', 's2': 'yes', 'late': 'no'}
    assert people['simulated'].to_dict() == {'s1': 'yes', 's2': 'yes', 'late': 'no'}
    answers = found['answers.csv']
    assert len(answers) == 2 * 2 * 6
    assert answers['value'].between(1, 21).all()
    parts = found['parts.csv']
    places = parts[parts['part'] == 'teach'].set_index(['participant', 'condition'])['place']
    assert places.to_dict() == {
        ('s1', 'trees'): 1,
        ('s1', 'goal'): 2,
        ('s2', 'goal'): 1,
        ('s2', 'trees'): 2,
    }
    status = status_table(folder.protocol(), records).set_index('participant')
    assert status['next'].to_dict() == {'s1': '-', 's2': '-', 'late': 'consent'}
