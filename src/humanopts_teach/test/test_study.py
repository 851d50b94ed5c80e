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
from humanopts_learner.summary import Criterion, OptionSummary
from humanopts_teach.cli import main
from humanopts_teach.commands.study_session import simulated_part
from humanopts_teach.dialogue.study import StudyApp
from humanopts_teach.language import _, speaking, spoken
from humanopts_teach.lesson.requests import CancelRun, EndDemonstration, SetControl, Verdict, World
from humanopts_teach.study.codebook import codebook
from humanopts_teach.study.plan import (
    balanced_latin_square,
    Part,
    PartKind,
    PARTS,
    PlanFileError,
    read_plan,
    StudyPlan,
)
from humanopts_teach.study.progress import participants_table, places_table
from humanopts_teach.study.protocol import Protocol
from humanopts_teach.study.questions import Question, QuestionKind, Questionnaire
from humanopts_teach.study.record import OpenRecord, StudyError, StudyFolder
from humanopts_teach.study.tables import read_study, tables
from hypothesis import given, HealthCheck, settings
from hypothesis import strategies as st
import pytest
from teach_support import snapshot
from teach_support.desk import Desk
import yaml

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
    return [part.key for part in plan.parts_of(number, number)]


def test_a_participant_goes_through_all_parts_in_the_order_of_the_number(plan: StudyPlan) -> None:
    before = ['consent', 'welcome/1', 'welcome']
    trees, goal = (
        [f'{name}/{part}' for part in ('play', 'buttons', 'teach', 'questions')]
        for name in ('trees', 'goal')
    )
    once = [key for key in trees + goal if not key.endswith('buttons')]  # one game, asked once
    assert keys(plan, 0) == keys(plan, 2) == [*before, *trees, *once[3:]]
    assert keys(plan, 1) == [*before, *goal, *once[:3]]
    parts = plan.parts_of(0, 0)
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


def test_a_condition_can_be_without_random_moves(write: Write) -> None:
    plan = read_plan(write(PLAN.replace('learn: goal', 'learn: goal, unstick: no')))
    assert [each.unstick for each in plan.conditions] == [True, False]


def test_a_condition_can_be_without_pictures(write: Write) -> None:
    plan = read_plan(write(PLAN.replace('learn: goal', 'learn: goal, picture: no')))
    assert [each.picture for each in plan.conditions] == [True, False]


def test_each_participant_gets_one_condition_in_turn_and_the_buttons_to_teach(
    write: Write,
) -> None:
    text = PLAN.replace('study:', 'order: one\nparticipants: 4\nstudy:')
    text = text.replace('name: trees', 'name: trees, teach_buttons: [fetch, bring]')
    plan = read_plan(write(text.replace('learn: goal', 'teach: 0')))
    order = [[each.name for each in plan.order_of(number)] for number in range(4)]
    assert order == [['trees'], ['goal'], ['trees'], ['goal']]
    (teaching,) = [part for part in plan.parts_of(0, 0) if part.kind is PartKind.TEACH]
    assert teaching.teach_buttons == ('fetch', 'bring')
    assert keys(plan, 1)[-3:] == ['goal/play', 'goal/buttons', 'goal/questions']


def test_a_random_order_is_that_of_the_seed(write: Write) -> None:
    path = write(PLAN.replace('study:', 'order: random\nstudy:'))
    one, again = read_plan(path), read_plan(path)
    assert [keys(one, n) for n in range(9)] == [keys(again, n) for n in range(9)]
    assert len({tuple(keys(one, n)) for n in range(9)}) == 2


LAKE = 'domain: "gymnasium:FrozenLake-v1", parameters: {is_slippery: "False"}'
CHANGES = [  # what is replaced in the plan, each time by something that cannot be used
    ('study:', ['colour: 1\nstudy:', 'order: any\nstudy:', 'study: a b #', 'study: [']),
    ('study:', ['order: one\nparticipants: 3\nstudy:']),
    ('learn: goal', ['teach_buttons: [x, x]', f'teach_buttons: [{61 * "x"}]']),
    ('study:', ['welcome: x\nstudy:', 'seed: 2026-13-45\nstudy:', 'seed: !!int x\nstudy:']),
    ('study:', ['all: {<<: {}}\nstudy:', 'participants: 3\nstudy:', 'participants: -1\nstudy:']),
    ('name: trees', ['names: trees', 'name: No', 'name: goal', 'name: 1.5', 'name: a b']),
    ('teach: 10', ['tech: 10', 'teach: -1', 'teach: ten', 'teach: yes', 'budget: 0']),
    ('buttons: 3', ['buttons: -1', 'strategy: luck', 'learn: magic', 'derive: [taxi_row - a]']),
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
        asked = read_plan(path).parts_of(0, 0)[-1].questions
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
        found: list[dict[str, Any]] = json.loads(capsys.readouterr().out)['participants']
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


def test_the_texts_of_a_language_are_part_of_the_plan(
    write: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    header = 'msgid ""\nmsgstr "Language: fr\\n"\n"Content-Type: text/plain; charset=UTF-8\\n"\n\n'
    texts = f'{header}# {4000 * "x"}\nmsgid "yes"\nmsgstr "oui"\n'
    (tmp_path / 'fr.po').write_text(texts)
    path = write(f'language: fr.po\n{PLAN}')
    folder = StudyFolder(tmp_path / 'study')
    folder.enter(read_plan(path), 'anna')
    place = [str(path), '--study', str(folder.path)]
    (tmp_path / 'fr.po').write_text(texts.replace('oui', 'si'))
    assert main(['study', *place, '--participant', 'ben']) == 2
    said = capsys.readouterr().err
    changes = {line[0] + line[1:].strip(' ",') for line in said.splitlines() if 'msgstr' in line}
    assert {'-msgstr \\"oui\\', '+msgstr \\"si\\'} <= changes
    assert 'accept the change with --accept-changes' in said
    assert main(['study', *place, '--accept-changes', '--participant', 'ben']) == 2
    changed = read_plan(path)
    folder.enter(changed, 'ben')
    (tmp_path / 'fr.po').unlink()
    for record, yes in zip(folder.records()[0], ('oui', 'si')):
        with speaking(folder.plan_of(changed, record).language):
            assert (spoken(), _('yes')) == ('fr', yes)
    assert str(tmp_path) not in (folder.path / 'protocol.jsonl').read_text()


def test_a_file_of_features_is_beside_the_plan(write: Write, tmp_path: Path) -> None:
    pole = '"gymnasium:CartPole-v1", parameters: {features: "seen.py:features"}'
    path = write(PLAN.replace('taxi', pole).replace(', learn: goal', ''))
    (path.parent / 'seen.py').write_text("def features(env):\n    return {'x': 1.0}\n")
    wanted = f'{path.parent}/seen.py:features'
    assert {each.parameters['features'] for each in read_plan(path).conditions} == {wanted}


LIKED = Question(name='liked', text='Did you like it?', low='not at all', high='very much')
AGAIN = LIKED.model_copy(update={'name': 'again'})
KINDS = (
    Question(
        name='know',
        text='Do you know it?',
        kind=QuestionKind.CHOICE,
        options=('yes', 'no'),
        expect=2,
    ),
    Question(
        name='seen', text='What did you see?', kind=QuestionKind.CHOICES, options=tuple('abcd')
    ),
    Question(
        name='age', text='How old are you?', kind=QuestionKind.NUMBER, least=18, unit='years'
    ),
    Question(name='more', text='What else?', kind=QuestionKind.TEXT, most=100),
)
PAGE = Part(kind=PartKind.PAGE, key='page', text='Read this.', reading=2.0)


def part(kind: PartKind, **fields: Any) -> Part:
    return Part(kind=kind, key=f'a/{kind.value}', condition='a', domain='taxi', **fields)


PARTS_OF = {
    'play': part(PartKind.PLAY, minutes=2.0),
    'buttons': part(PartKind.BUTTONS, most=2),
    'teach': part(PartKind.TEACH, minutes=10.0),
    'given': part(PartKind.TEACH, teach_buttons=('fetch', 'bring')),
    'questions': part(PartKind.QUESTIONS, questions=Questionnaire(items=(LIKED, AGAIN), points=5)),
    'practice': part(PartKind.PRACTICE),
    'idle': part(PartKind.PLAY, idle=2.0, task='Have a look.'),
    'kinds': part(PartKind.QUESTIONS, questions=Questionnaire(items=KINDS), most_failed=0),
}
BEGIN = '1 f e t c h enter y o enter left'  # a demonstration
SITTINGS = [  # first part, before the page; keys, and seconds after a plus
    ('play', ['escape']),
    ('practice', ['left up enter | down | enter | up n | backspace | ? | x n | enter']),
    ('play', ['+119.9 | +0.1']),
    ('buttons', ['f e t c h enter | g o enter']),
    ('buttons', ['escape']),
    (
        'questions',
        ['enter | right right | enter | left left 9 | backspace | enter | ? | x 4 enter'],
    ),
    ('kinds', ['z 2 1 | enter | 4 1 2 2 | enter | o l d enter | ctrl-u 4 4 , 5 enter enter']),
    ('kinds', ['2 | enter | 3 enter 7 0 enter escape escape | enter enter s o enter']),
    ('teach', ['5']),
    ('teach', [f'{BEGIN} | escape enter | 7 | n | 7 | enter']),
    ('given', ['6 | ? | 6 | enter']),
    ('teach', [f'{BEGIN} | +480 | +62 | +60']),
    ('idle', ['+120 | +10 | escape | +120 | +60', 'left']),
    ('teach', ['+250 | ctrl-c', '+345 | +10']),
]


def test_each_part_is_shown_and_recorded(tmp_path: Path, taxi: Domain) -> None:
    """Time is looked at each second; a part that was left continues where it was."""
    lines = []
    for number, (first, sittings) in enumerate(SITTINGS):
        path, now = tmp_path / f'{number}.jsonl', 1000.0
        for script in sittings:
            record = OpenRecord(path, clock=lambda: desk.now)  # noqa: B023
            left = record.remaining([PARTS_OF[first], PAGE])
            app = StudyApp(left, record, 'p1', World(), seed=1)
            desk = Desk(taxi, tmp_path / f'{number}', app=app)
            desk.now = now
            lines.append(f'\n== {", ".join(each.key for each in left)}')
            for step in ['', *script.split(' | ')]:
                lines.append(f'> {" ".join(step.split())}')
                if step.startswith('+'):
                    end = desk.now + float(step)
                    while desk.now < end:
                        desk.advance(min(1.0, end - desk.now))
                desk.press(*(() if step.startswith('+') else step.split())).advance().advance()
                lines += ['(ended)'] if app.ended else desk.see().split('\n')[1:-1]
            app.last_requests()
            now = desk.now + 1000.0
            desk.store.close()
        events = [event.model_dump(mode='json', exclude_unset=True) for event in record.events]
        lines += [
            ' '.join(str(value) for key, value in event.items() if key != 'condition')
            for event in events
            if event['event'] != 'still there'
        ]
    snapshot.check('study_parts.txt', '\n'.join(lines))


def test_a_crash_takes_no_more_of_the_time_at_a_part_than_five_seconds(
    tmp_path: Path, taxi: Domain
) -> None:
    path, now = tmp_path / 'a.jsonl', 0.0
    app = StudyApp(
        [PARTS_OF['teach'], PAGE], OpenRecord(path, clock=lambda: now), 'p1', World(), seed=1
    )
    app.world.domain = taxi
    while now < 209.0:
        app.world.summaries = [OptionSummary('fetch', 'p1', n_demonstrations=1)]
        app.advance(now)
        now += 1.0
    record = OpenRecord(path)
    assert record.seconds_in('a/teach') == 205.0
    assert [len(event.options) for event in record.of('learned')] == [1]


def test_a_run_of_the_exam_ends_with_the_time(tmp_path: Path, taxi: Domain) -> None:
    app = StudyApp(
        [PARTS_OF['teach'], PAGE], OpenRecord(tmp_path / 'a.jsonl'), 'p1', World(), seed=1
    )
    desk = Desk(taxi, tmp_path, app=app).advance().advance()
    met = Criterion.of('success', 1.0, 0.95)
    desk.exam, desk.reports = 2, {'fetch': OptionSummary('fetch', 'p1', criteria=(met,))}
    desk.press(*BEGIN.split(), 'enter', 'enter').machine('east')
    desk.advance(600.0).advance()
    cut = EndDemonstration(Verdict.DISCARD, 3, 1)
    assert desk.asked[-2:] == [CancelRun(), cut]
    assert 'Read this.' in desk.see()
    desk.store.close()


def test_teaching_that_another_person_has_taken_over_ends_without_a_request_to_their_lesson(
    tmp_path: Path, taxi: Domain
) -> None:
    app = StudyApp(
        [PARTS_OF['teach'], PAGE], OpenRecord(tmp_path / 'a.jsonl'), 'p1', World(), seed=1
    )
    desk = Desk(taxi, tmp_path, app=app).advance().advance().press(*BEGIN.split())
    desk.shows('bob')
    desk.asked.clear()
    app.end()
    assert 'Read this.' in desk.advance().see()
    assert desk.asked == [SetControl(hold=False)]
    assert 'bob' not in desk.see()
    desk.store.close()


def test_a_simulated_study_makes_tables_that_the_codebook_explains(
    plan: StudyPlan, tmp_path: Path
) -> None:
    folder = StudyFolder(tmp_path / 'study')
    option = OptionSummary('fetch', 's', n_demonstrations=4)
    for code in ('s1', 's2'):
        who = folder.enter(plan, code, simulated=True)
        record = OpenRecord(who.path)
        for part in plan.parts_of(who.place, who.number):
            simulated_part(part, record, plan.seed, who.number, lambda: [option])
        record.note('ended')
    folder.enter(plan, 'late')
    data, problems = read_study(folder, time.time())
    assert problems == []
    found = tables(data)
    for name, columns in codebook().items():
        assert list(found[name].columns) == list(columns)
        assert all(len(column.label.encode()) <= 256 for column in columns.values())  # for SPSS
    taught = found['options']
    assert list(taught['participant']) == ['s1', 's1', 's2', 's2']
    assert set(taught['demonstrations']) == {4}
    assert taught['return_shown'].isna().all()  # not measured
    people = found['participants'][['participant', 'order', 'ended', 'simulated']]
    assert people.to_numpy().tolist() == [
        ['s1', 'trees goal', 'yes', 'yes'],
        ['s2', 'goal trees', 'yes', 'yes'],
        ['late', 'trees goal', 'no', 'no'],
    ]
    answers = found['answers']
    assert len(answers) == 2 * 2 * 6
    assert answers['value'].between(1, 21).all()
    parts = found['parts']
    places = parts[parts['kind'] == 'teach'][['participant', 'condition', 'position']]
    assert places.to_numpy().tolist() == [
        ['s1', 'trees', 1], ['s1', 'goal', 2], ['s2', 'goal', 1], ['s2', 'trees', 2],
    ]  # fmt: skip
    progress = participants_table(data.protocol, data.records, ['late'], 24.0, time.time())
    assert progress[['state', 'parts done', 'parts', 'next']].to_numpy().tolist() == [
        *[['finished', 10, 10, '-']] * 2, ['running', 0, 10, 'consent'],
    ]  # fmt: skip
    places = places_table(plan.model_copy(update={'participants': 4}), data.records, time.time())
    assert places.to_numpy().tolist() == [['trees, goal', 1, 1, 0], ['goal, trees', 1, 0, 1]]
