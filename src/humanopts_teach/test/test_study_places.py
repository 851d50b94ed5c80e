"""Who takes part in a study: consent, places, two people with one code, deletions and pilots."""

from collections import Counter
import io
import json
import os
from pathlib import Path
import random
import resource
import subprocess
import sys
from typing import Any, get_args

from humanopts_teach.cli import main
from humanopts_teach.commands.study_session import Study
from humanopts_teach.study.events import Event, event_of, EventKind, FAILED, FINISHED
from humanopts_teach.study.log import StudyLog
from humanopts_teach.study.plan import PlanFileError, read_plan, StudyPlan
from humanopts_teach.study.questions import MAX_POINTS, Question, QuestionKind, Questionnaire
from humanopts_teach.study.record import (
    EndedError,
    FullError,
    OpenRecord,
    Record,
    StudyError,
    StudyFolder,
)
from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

PLAN = """
study: st
consent: consent.md
participants: 4
all: {domain: rooms, teach: 1, questions: q.yaml}
conditions: [{name: a}, {name: b}]
attention: {most_failed: 0}
recruiting:
  code: PROLIFIC_PID
  columns: [STUDY_ID]
  completed: https://app.prolific.com/submissions/complete?cc=C1
  failed: https://app.prolific.com/failed?who={code}
"""
QUESTIONS = """
order: random
items:
  - {name: easy, text: Easy?, low: no, high: very}
  - {name: check, text: Press 3., low: not, high: very, expect: 3}
  - {name: age, text: Age?, kind: number, least: 18, unit: years}
  - {name: which, text: Which?, kind: choice, options: [one, two]}
  - {name: all, text: Which of them?, kind: choices, options: [one, two, three]}
  - {name: words, text: Why?, kind: text}
""".replace('low: no,', 'low: "no",')
HOUR = 3600.0


class Clock:
    """The time of a test, in s since 1970."""

    now = 1000.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """The file of a plan, beside its page and its questions."""
    (tmp_path / 'consent.md').write_text('First.\n\n---\n\nDo you agree?\n')
    (tmp_path / 'q.yaml').write_text(QUESTIONS)
    (tmp_path / 'plan.yaml').write_text(PLAN)
    return tmp_path / 'plan.yaml'


@pytest.fixture
def plan(path: Path) -> StudyPlan:
    """The plan, with four places and two orders."""
    return read_plan(path)


@pytest.fixture
def clock() -> Clock:
    """The time."""
    return Clock()


@pytest.fixture
def folder(tmp_path: Path, clock: Clock) -> StudyFolder:
    """The folder of the study, which does not exist yet."""
    return StudyFolder(tmp_path / 'study', clock)


def files(folder: StudyFolder) -> list[str]:
    return sorted(path.name for path in folder.path.rglob('*')) if folder.path.exists() else []


def decline(study: Study, code: str) -> None:
    app = study.consent_app(code)
    assert app is not None
    for key in ('enter', 'n'):
        app.drawn()
        for keys in ([], [], [key]):  # displayed, read, decided
            app.type(keys)
            app.advance(app.now + 3.0)
    assert app.agreed is False


def note(record: Record, clock: Clock, *kinds: Any, **values: Any) -> None:
    for kind in kinds:
        OpenRecord(record.path, clock=clock).note(kind, **values)


def refused(folder: StudyFolder, plan: StudyPlan, code: str, kind: type = StudyError) -> str:
    with pytest.raises(kind) as raised:
        folder.enter(plan, code)
    text = str(raised.value)
    assert text.isprintable()
    return text


def test_nothing_is_written_before_a_person_agrees(plan: StudyPlan, folder: StudyFolder) -> None:
    study = Study(plan, folder, '/')
    app = study.consent_app('anna')
    assert app is not None
    assert not folder.path.exists()
    assert study.declined().text.startswith('Nothing was saved.')
    for _ in range(2):  # the page is loaded again
        decline(study, 'ben')
    assert files(folder) == ['.lock', 'log.jsonl']
    (line,) = (folder.path / 'log.jsonl').read_text().splitlines()
    assert json.loads(line).keys() == {'event', 'time'}
    with study.enter('anna', consent_seconds=30.0, browser='Firefox', width=390) as record:
        began, *consent, client = OpenRecord(record.path).events
        assert (began.number, began.place) == (0, 0)
        assert [(each.part, each.event) for each in consent] == [
            ('consent/1', 'part began'), ('consent/1', 'part ended'),
            ('consent', 'part began'), ('consent', 'part ended'),
        ]  # fmt: skip
        assert record.seconds_in('consent') == pytest.approx(30.0, abs=0.01)
        assert (client.event, client.browser, client.width) == ('client', 'Firefox', 390)
        left = record.remaining(plan.parts_of(0, 0))
        assert [each.key for each in left] == [
            f'{name}/{part}' for name in 'ab' for part in ('teach', 'questions')
        ]
        assert study.consent_app('anna') is None  # already given


def test_a_person_counts_once_by_the_latest_visit(plan: StudyPlan, folder: StudyFolder) -> None:
    study = Study(plan, folder, '/')
    for code in ('anna', 'ben', 'anna'):
        decline(study, code)
    for number in range(4):
        folder.enter(plan, f'p{number}')
    for code in ('anna', 'cleo', 'cleo'):
        with pytest.raises(FullError):
            study.consent_app(code)
    log = StudyLog(folder.path)
    assert (log.people('declined'), log.people('full')) == (1, 2)
    folder.withdraw('p2')
    with study.enter('cleo', consent_seconds=1.0):
        pass
    log = StudyLog(folder.path)
    assert (log.people('declined'), log.people('full'), log.people('withdrawn')) == (1, 1, 1)
    text = log.path.read_text()
    assert not any(code in text for code in ('anna', 'ben', 'cleo'))


def test_a_full_disk_at_consent_leaves_nothing_of_the_person(
    plan: StudyPlan, folder: StudyFolder, capsys: pytest.CaptureFixture[str]
) -> None:
    study = Study(plan, folder, '/')
    folder.enter(plan, 'first')  # and the protocol
    before = files(folder)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, hard))
    try:
        with pytest.raises(StudyError) as raised, study.enter('anna', consent_seconds=1.0):
            pass
        with pytest.raises(OSError, match='File too large'), study.enter('first', width=390):
            pass
        resource.setrlimit(resource.RLIMIT_FSIZE, (0, hard))
        decline(study, 'ben')
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    text = 'The study cannot begin right now, and nothing was saved.'
    assert str(raised.value).startswith(text)
    began, declined = capsys.readouterr().err.splitlines()
    assert 'anna could not begin, and nothing was saved: ' in began
    assert 'the number of people in the log is wrong by one: ' in declined
    assert {*files(folder)} - {*before} <= {'log.jsonl'}
    with study.enter('anna', consent_seconds=1.0) as record:
        assert record.number == 1


def test_places_belong_to_those_who_finish(
    plan: StudyPlan, folder: StudyFolder, clock: Clock
) -> None:
    people = [folder.enter(plan, f'p{number}') for number in range(4)]
    assert [each.place for each in people] == [0, 1, 2, 3]
    text = 'All 4 places of the study are taken; nothing was saved.'
    assert refused(folder, plan, 'late', FullError) == text
    assert 'late' not in ' '.join(files(folder))
    note(people[0], clock, 'ended')
    where = {'part': 'a/questions', 'condition': 'a', 'kind': 'questions', 'why': FAILED}
    note(people[1], clock, 'part ended', **where)
    note(people[1], clock, 'ended')  # excluded
    folder.withdraw('p2')
    again = [folder.enter(plan, code) for code in ('q1', 'q2')]
    assert [(each.place, each.number) for each in again] == [(1, 4), (2, 5)]
    clock.now += 23.9 * HOUR
    for record in again:
        note(record, clock, 'still there', part='a/teach', condition='a')
    refused(folder, plan, 'late', FullError)
    clock.now += 0.2 * HOUR  # p3 has not come back
    late = folder.enter(plan, 'late')
    assert (late.place, late.number) == (3, 6)
    back = folder.enter(plan, 'p3')  # goes on with the same order
    assert (back.place, back.number) == (3, 3)
    refused(folder, plan, 'more', FullError)


@pytest.mark.parametrize('seed', range(3))
def test_orders_are_balanced_whoever_drops_out(
    plan: StudyPlan, folder: StudyFolder, clock: Clock, seed: int
) -> None:
    plan, chance = plan.model_copy(update={'participants': 10}), random.Random(seed)
    here: list[Record] = []
    done: list[Record] = []
    for number in range(60):
        clock.now += HOUR
        try:
            here.append(folder.enter(plan, f'p{number}'))
        except FullError:
            assert len(done) + len(here) == 10
        for record in tuple(here):
            how = chance.choices(['stays', 'finishes', 'withdraws', 'leaves'], [12, 4, 1, 1])[0]
            if how != 'stays':
                here.remove(record)
            if how == 'finishes':
                done.append(record)
                note(record, clock, 'ended')
            elif how == 'withdraws':
                folder.withdraw(record.code)
            elif how == 'stays':
                note(record, clock, 'still there', part='a/teach', condition='a')
            else:
                clock.now += 24 * HOUR
                for other in here:
                    note(other, clock, 'still there', part='a/teach', condition='a')
    assert sorted(record.place for record in done) == list(range(10))
    assert Counter(tuple(c.name for c in plan.order_of(r.place)) for r in done) == {
        ('a', 'b'): 5,
        ('b', 'a'): 5,
    }


def test_one_person_takes_part_in_one_place_at_a_time(
    plan: StudyPlan, folder: StudyFolder
) -> None:
    study = Study(plan, folder, '/')
    text = "'anna' is taking part in another window or terminal at the moment."
    with study.enter('anna') as record:
        assert folder.running() == {'anna'}
        with pytest.raises(StudyError) as raised, study.enter('anna'):
            pass
        assert str(raised.value) == text
        with pytest.raises(StudyError, match="'anna' is taking part at the moment"):
            folder.withdraw('anna')
    assert folder.running() == set()
    program = (
        'import fcntl, sys\n'
        'file = open(sys.argv[1])\n'
        'fcntl.flock(file, fcntl.LOCK_EX)\n'
        'print(flush=True)\n'
        'input()\n'
    )
    words = [sys.executable, '-c', program, record.path]
    pipes = {'stdin': subprocess.PIPE, 'stdout': subprocess.PIPE}
    with subprocess.Popen(words, text=True, **pipes) as other:  # type: ignore[call-overload]
        other.stdout.readline()
        assert folder.running() == {'anna'}
        with pytest.raises(StudyError, match='another window'), study.enter('anna'):
            pass
        other.communicate('\n')
    with study.enter('anna') as record:
        assert record.number == 0


def test_a_code_of_another_study_is_refused(
    plan: StudyPlan, folder: StudyFolder, tmp_path: Path
) -> None:
    other = plan.model_copy(update={'study': 'other'})
    folder.enter(other, 'anna')
    text = refused(folder, plan, 'ben').replace(str(tmp_path), 'DIR')
    assert (
        text
        == "DIR/study is the folder of the study 'other', not of 'st'; --study DIR names another"
    )
    (folder.path / 'protocol.jsonl').unlink()
    record = folder.path / '000-anna.jsonl'
    event = json.loads(record.read_text())
    record.write_text(json.dumps({**event, 'protocol': ''}) + '\n')
    text = "'anna' is taking part in the study 'other', not in 'st'"
    assert refused(folder, plan, 'anna') == text


def test_a_return_after_the_end_is_refused(
    plan: StudyPlan, folder: StudyFolder, clock: Clock
) -> None:
    anna = folder.enter(plan, 'anna')
    note(anna, clock, 'ended')
    study, before = Study(plan, folder, '/'), anna.path.read_bytes()
    with pytest.raises(EndedError) as raised:
        study.consent_app('anna')
    assert str(raised.value) == "'anna' has already ended this study; use another code"
    assert study.farewell(raised.value.record).url == plan.recruiting.completed
    assert anna.path.read_bytes() == before


def test_a_deletion_leaves_no_trace_of_the_code(
    path: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sys, 'stdin', io.StringIO())
    plan, folder = read_plan(path), StudyFolder(tmp_path / 'study')
    for code in ('p-anna', 'p-ben'):
        record = folder.enter(plan, code)
        bags = folder.path / code / 'a' / 'bags' / 'study-1'
        bags.mkdir(parents=True)
        (bags / 'bag.mcap').write_text(code)
    (folder.path / '001-p-ben.jsonl.torn').write_text('{"participant": "p-ben"')
    words = [str(path), 'p-ben', '--study', str(folder.path)]
    assert main(['study', 'withdraw', *words]) == 2  # no one answers the question
    assert 'nothing was deleted' in capsys.readouterr().err
    assert record.path.exists()
    assert main(['study', 'withdraw', *words, '--yes']) == 0
    said = capsys.readouterr().out
    assert said.startswith('3 files of p-ben have been deleted. Tables and reports')
    left = [each for each in folder.path.rglob('*') if 'p-ben' in str(each)]
    assert left == []
    assert all(b'p-ben' not in each.read_bytes() for each in folder.path.rglob('*.jsonl'))
    assert [(e.event, e.number, e.files) for e in StudyLog(folder.path).entries] == [
        ('withdrawn', 1, 3)
    ]
    assert (folder.path / 'p-anna' / 'a' / 'bags' / 'study-1' / 'bag.mcap').exists()
    assert main(['study', 'withdraw', *words, '--yes']) == 2
    assert f"'p-ben' has no record in {folder.path}" in capsys.readouterr().err
    carl = folder.enter(plan, 'carl')
    assert (carl.number, carl.place) == (2, 1)


def test_a_pilot_is_a_study_of_its_own(
    path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan, main_folder = read_plan(path), StudyFolder(tmp_path / 'study')
    StudyFolder(main_folder.path / 'pilot').enter(plan, 'tester')
    main_folder.enter(plan, 'anna')
    place = [str(path), '--study', str(main_folder.path)]
    found = {}
    for pilot in ([], ['--pilot']):
        assert main(['study', 'status', *place, *pilot, '--json']) == 0
        (row,) = json.loads(capsys.readouterr().out)['participants']
        assert main(['study', 'export', *place, *pilot]) == 0
        found[row['participant']] = capsys.readouterr().out
    assert list(found) == ['anna', 'tester']
    assert str(main_folder.path / 'pilot' / 'tables') in found['tester']
    for code in ('pilot', 'Tables'):
        assert refused(main_folder, plan, code) == (
            f'{code!r} cannot be used as a code; use another one'
        )


def test_status_shows_people_and_places(
    path: Path, folder: StudyFolder, clock: Clock, capsys: pytest.CaptureFixture[str]
) -> None:
    plan, study = read_plan(path), Study(read_plan(path), folder, '/')
    clock.now = 1e9
    for code, how in (('old', 'part left'), ('anna', 'ended')):
        where = {'part': 'a/teach', 'condition': 'a'} if how == 'part left' else {}
        note(folder.enter(plan, code), clock, how, **where)
    decline(study, 'cleo')
    with StudyFolder(folder.path).hold(StudyFolder(folder.path).enter(plan, 'ben')):
        assert main(['study', 'status', str(path), '--study', str(folder.path)]) == 0
    lines = [' '.join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert lines[0] == f'st: 3 participants, 4 places, in {folder.path}'
    assert lines[2:] == [
        'participant order state parts done parts next minutes',
        'old a, b left, place free 0 6 consent/1 0.0',
        'anna b, a finished 0 6 - 0.0',
        'ben a, b running 0 6 consent/1 0.0',
        '',
        'places',
        'order finished under way places left',
        'a, b 0 1 1',
        'b, a 1 0 1',
        '1 declined',
    ]


def test_too_many_failed_attention_checks_end_the_study(
    plan: StudyPlan, folder: StudyFolder
) -> None:
    study, code = Study(plan, folder, '/'), 'p&1'.replace('&', '_')
    with study.enter(code) as record:
        (part,) = [each for each in plan.parts_of(0, 0) if each.key == 'a/questions']
        notes = OpenRecord(record.path)
        notes.note('part began', part)
        for value, why in ((3, FINISHED), (2, FAILED)):  # changed by going back
            notes.note('answer', part, item='check', value=value, points=7)
            assert notes.check_attention(part) == why
        assert part.most_failed == 0
        notes.note('part ended', part, why=FAILED)
        farewell = study.next_turn(record)
    assert farewell == (
        'The study ends here: too many attention checks were failed.',
        'https://app.prolific.com/failed?who=p_1',
    )
    assert folder.enter(plan, 'next').place == 0
    with pytest.raises(EndedError):
        folder.enter(plan, code)


ADDRESSES = ['http://a.org/x', 'javascript:alert(1)', '//a.org', 'https://a b', 'two words', '']


def test_only_addresses_of_the_plan_with_https_are_accepted(path: Path) -> None:
    for key in ('completed', 'declined', 'failed'):
        for address in ADDRESSES:
            path.write_text(f'{PLAN.split("recruiting:")[0]}recruiting: {{{key}: "{address}"}}\n')
            with pytest.raises(PlanFileError) as raised:
                read_plan(path)
            assert str(raised.value).startswith(f'recruiting {key}: ')
    path.write_text(PLAN.replace('https://app.prolific.com/submissions/complete?cc=C1', 'C1'))
    assert read_plan(path).recruiting.completed == 'C1'


@pytest.mark.parametrize(
    ('page', 'line'),
    [
        ('# A\n\n<script>alert(1)</script>\n', 3),
        ('One *two*\nthree <b>bold</b>\n', 2),
        ('<!-- a remark -->\n', 1),
    ],
)
def test_html_in_a_page_is_refused(path: Path, page: str, line: int) -> None:
    (path.parent / 'consent.md').write_text(page)
    with pytest.raises(PlanFileError, match=rf'consent.md: line {line} has HTML, <.*; use Markd'):
        read_plan(path)
    (path.parent / 'consent.md').write_text('a < b, `<b>`, \\<b>, <https://a.org>\n')
    assert read_plan(path).consent_parts


ENDS = {'low': 'l', 'high': 'h'}
BAD_QUESTIONS = {
    'kind: rating, low: a': 'give low and high, the labels of the ends of the scale',
    'kind: choice, options: [a]': 'give at least two options, all of them different',
    'kind: choice, options: [a, a]': 'give at least two options, all of them different',
    'kind: number, least: 2, most: 1': 'least is greater than most',
    'kind: text, options: [a, b]': 'options does not belong to a question of kind text',
    'kind: text, most: 0': 'most: use 1 to 1000 characters',
    'kind: choice, options: [a, b], expect: 3': 'no one can give the answer that is expected',
    'kind: slider': "it should be 'rating', 'choice', 'choices', 'number' or 'text'",
}


@pytest.mark.parametrize('given', BAD_QUESTIONS)
def test_a_question_that_cannot_be_asked_is_refused(path: Path, given: str) -> None:
    (path.parent / 'q.yaml').write_text(f'items: [{{name: x, text: x, {given}}}]\n')
    with pytest.raises(PlanFileError) as raised:
        read_plan(path)
    assert BAD_QUESTIONS[given] in str(raised.value)
    assert str(raised.value).isprintable()


def test_items_have_an_order_of_their_own_for_each_participant(plan: StudyPlan) -> None:
    def items(number: int) -> list[list[str]]:
        asked = [part.questions for part in plan.parts_of(0, number) if part.questions]
        return [[item.name for item in each.items] for each in asked]

    assert items(1) == items(1)
    assert len({str(items(number)) for number in range(9)}) == 9
    assert {tuple(sorted(each)) for n in range(9) for each in items(n)} == {
        ('age', 'all', 'check', 'easy', 'which', 'words')
    }


QUESTION = st.one_of(
    st.just(Question(name='x', text='x', **ENDS)),
    st.builds(
        lambda kind, count: Question(
            name='x', text='x', kind=kind, options=tuple(map(str, range(count)))
        ),
        st.sampled_from([QuestionKind.CHOICE, QuestionKind.CHOICES]),
        st.integers(2, 50),
    ),
    st.builds(
        lambda limits: Question(
            name='x', text='x', kind=QuestionKind.NUMBER, least=limits[0], most=limits[1]
        ),
        st.lists(st.integers(-999, 999) | st.floats(-999, 999), min_size=2, max_size=2).map(sorted)
        | st.sampled_from([(None, None), (3, None), (None, -3), (0.5, None)]),
    ),
    st.builds(
        lambda most: Question(name='x', text='x', kind=QuestionKind.TEXT, most=most),
        st.integers(1, 1000),
    ),
)


@given(QUESTION, st.integers(2, MAX_POINTS), st.integers(0, 99))
def test_a_simulated_answer_is_one_and_is_recorded_as_it_is(
    question: Question, points: int, seed: int
) -> None:
    value = question.draw(np.random.default_rng(seed), points)
    assert question.accepts(value, points)
    assert not question.accepts(True, points)
    assert question.accepts(None, points) == (question.kind is QuestionKind.TEXT)
    check = question.model_copy(update={'expect': value})
    assert check.passes(value)
    assert (
        Questionnaire(items=(check,), points=points)
        .items[0]
        .draw(np.random.default_rng(seed + 1), points)
        == value
    )
    event = {'event': 'answer', 'time': 1.0, 'part': 'a', 'item': 'x', 'value': value}
    assert event_of(json.dumps(event)).value == value


def test_new_codes_are_new_and_can_be_used(plan: StudyPlan, folder: StudyFolder) -> None:
    codes = {folder.new_code() for _ in range(100)}
    assert len(codes) == 100
    assert folder.enter(plan, codes.pop()).number == 0
    assert os.listdir(folder.path)


def test_the_reference_has_every_event_and_its_fields() -> None:
    text = (Path(__file__).parents[3] / 'docs' / 'reference' / 'files.md').read_text('utf-8')
    fields = set(Event.model_fields) - {'event', 'time', 'condition', 'kind'}
    words = {*get_args(EventKind), *fields}
    assert [each for each in sorted(words) if f'`{each}`' not in text] == []
