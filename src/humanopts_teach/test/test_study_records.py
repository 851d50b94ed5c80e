"""Records of a study that other programs, crashes and people have changed, seen from outside."""

from collections.abc import Mapping
import csv
import json
import os
from pathlib import Path
import sys
import time
from typing import Any

from graph_support.live import free_domain_id
from humanopts_learner.spreadsheet import from_cell, to_cell
from humanopts_teach.cli import main
from humanopts_teach.study.events import event_of
from humanopts_teach.study.plan import read_plan
from humanopts_teach.study.record import StudyError, StudyFolder
from hypothesis import given, HealthCheck, settings
from hypothesis import strategies as st
import pandas as pd
import pexpect
import pytest

PLAN = """
study: st
order: fixed
all: {domain: rooms, teach: 0.25, buttons: 2, questions: q.yaml}
conditions: [{name: a}, {name: b}]
"""
QUESTIONS = """
items:
  - {name: easy, text: It was easy., low: not at all, high: very}
  - {name: quick, text: It was quick., low: not at all, high: very}
"""
Row = dict[str, Any]


class Files:
    """A plan and its folder of records, read by the command line."""

    def __init__(self, path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        self.path, self.study, self._capsys = path, path / 'study', capsys
        self.study.mkdir()
        (path / 'plan.yaml').write_text(PLAN)
        (path / 'q.yaml').write_text(QUESTIONS)

    def write(self, name: str, *events: Mapping[str, Any] | str) -> Path:
        lines = [each if isinstance(each, str) else json.dumps(each) for each in events]
        path = self.study / name
        path.write_text(''.join(f'{line}\n' for line in lines), errors='surrogateescape')
        return path

    def run(self, command: str, *more: str) -> tuple[int, str, str]:
        """Return status, output and errors."""
        arguments = ['study', command, str(self.path / 'plan.yaml'), '--study', str(self.study)]
        status = main([*arguments, *more])
        return status, *self._capsys.readouterr()

    def status(self) -> tuple[list[Row], str]:
        code, output, errors = self.run('status', '--json')
        assert code == 0
        return json.loads(output)['participants'], errors

    def export(self, name: str, *columns: str) -> tuple[list[tuple[str, ...]], str]:
        """Return columns of a table that is exported, and the errors."""
        code, _, errors = self.run('export')
        assert code == 0
        with (self.study / 'tables' / name).open(encoding='utf-8', newline='') as file:
            rows = list(csv.DictReader(file))
        return [tuple(row[column] for column in columns) for row in rows], errors


@pytest.fixture
def files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Files:
    """The files of a study without participants."""
    return Files(tmp_path, capsys)


def began(code: str, number: int = 0) -> Row:
    who = {'participant': code, 'number': number, 'place': number, 'simulated': False}
    return {'event': 'began', 'time': 100.0, 'study': 'st', 'order': ['a', 'b'], **who}


def at(seconds: float, event: str, part: str = 'a/questions', **more: Any) -> Row:
    where = {'part': part, 'condition': part.partition('/')[0]}
    if event.startswith('part'):
        more['kind'] = part.rpartition('/')[2]
    return {'event': event, 'time': seconds, **where, **more}


def ended(seconds: float, part: str, why: str = 'finished') -> Row:
    return at(seconds, 'part ended', part, why=why)


def answer(seconds: float, item: str, value: Any, part: str = 'a/questions') -> Row:
    return at(seconds, 'answer', part, item=item, value=value, points=7)


def button(seconds: float, rank: int, text: str) -> Row:
    return at(seconds, 'button', 'a/buttons', domain='rooms', rank=rank, text=text)


def learned(seconds: float, *names: str) -> Row:
    numbers = {'demonstrations': 3, 'not_here': 1, 'return_shown': -5.0, 'return_learned': None}
    exam = {'questions': 2, 'exam_right': 5, 'exam_runs': 5, 'exams_failed': 0}
    found = {'criteria_met': True, 'learned': True, 'status': 'learned: so it is', **exam}
    rows = [{'option': n, 'method': 'goal', **found, **numbers} for n in names]
    return at(seconds, 'learned', 'a/teach', options=rows)


SPOILT = [
    *('', '{"event": "answer"', '[]', '{"event": ["began"], "time": 1}'),
    *('{"event": "sang", "time": 1.0}', '[' * 50_000, '{"event": "answer", "item": "\udcff"}'),
    '{"condition": "", "event": "part began", "kind": "page", "time": 1}',
    *(json.dumps(answer(1, 'x', value)) for value in (3.5, 8, True, 10**400)),
    *(json.dumps({**answer(1, 'x', 3), 'time': bad}) for bad in (float('nan'), '1')),
    json.dumps({**answer(1, 'x', 3), 'part': None}),
    json.dumps(answer(1, '\ud800', 3)),
    json.dumps({**ended(1, 'a/teach'), 'why': 'bored'}),
]


def test_a_line_that_is_no_event_is_named_and_not_counted(files: Files) -> None:
    path = files.write('000-x1.jsonl', began('x1'), *SPOILT, answer(120, 'easy', 3))
    rows, errors = files.export('answers.csv', 'participant', 'item', 'value')
    assert rows == [('x1', 'easy', '3')]
    left_out = [f'line {number} of {path} is left out: ' for number in range(2, len(SPOILT) + 2)]
    assert all(line in errors for line in left_out)
    assert errors.count('\n') == len(SPOILT)
    found, errors = files.status()
    assert [row['participant'] for row in found] == ['x1']
    assert all(line in errors for line in left_out)


def test_copies_and_empty_files_are_named_and_not_counted(files: Files) -> None:
    lines = began('p1'), answer(120, 'easy', 3)
    files.write('000-p1.jsonl', *lines)
    files.write('000-p1 (conflicted copy 2026-11-01).jsonl', *lines)
    files.write('000-p1-DESKTOP.jsonl', *lines)
    files.write('000-p1-LAPTOP.jsonl', *lines[1:])  # its first line is damaged
    files.write('p1.jsonl', *lines)
    files.write('002-p1.jsonl', began('p1', 2))
    files.write('003-p3.jsonl')
    os.mkfifo(files.study / '004-p4.jsonl')
    (files.study / '005-p5.jsonl').mkdir()
    (files.study / '006-p6.jsonl').symlink_to(files.study / '000-p1.jsonl')
    files.write('1000-p1001.jsonl', began('p1001', 1000), answer(120, 'easy', 4))
    found, errors = files.status()
    assert [row['participant'] for row in found] == ['p1', 'p1001']
    assert errors.count('\n') == errors.count(' is left out: ') == 9
    rows, errors = files.export('answers.csv', 'value')
    assert rows == [('3',), ('4',)]
    assert errors.count('\n') == 9


@pytest.mark.parametrize('spoilt', ['damaged', ''])
def test_who_has_a_record_that_cannot_be_used_gets_no_second_one(
    files: Files, spoilt: str
) -> None:
    if spoilt:
        files.write('000-p1.jsonl', spoilt)
    else:
        (files.study / '000-p1.jsonl').mkdir()
    folder, plan = StudyFolder(files.study), read_plan(files.path / 'plan.yaml')
    with pytest.raises(StudyError, match=r"'p1' has a record that cannot be used: .* is left out"):
        folder.enter(plan, 'p1')
    assert folder.enter(plan, 'p2').number == 1


def test_a_folder_that_is_none_is_named(files: Files) -> None:
    os.rmdir(files.study)
    code, _, errors = files.run('export')
    assert code == 2
    assert f'no one has taken part yet in {files.study}' in errors
    assert not files.study.exists()
    files.study.write_text('no folder')
    for command in ('status', 'export', 'run'):
        code, _, errors = files.run(command)
        assert (code, errors.count('\n')) == (2, 1)
        assert 'Not a directory' in errors


def test_a_participant_without_a_beginning_is_still_one(files: Files) -> None:
    files.write('000-p1.jsonl', 'damaged', answer(120, 'easy', 3), {'event': 'ended', 'time': 130})
    columns = 'participant', 'number', 'ended', 'simulated', 'order'
    (person,), errors = files.export('participants.csv', *columns)
    assert person == ('p1', '0', 'yes', '', '')
    assert errors.count('\n') == 1


def test_of_all_that_does_not_fit_the_first_lines_are_named(files: Files) -> None:
    files.write('000-p1.jsonl', began('p1'), *['?'] * 100_000, answer(120, 'easy', 3))
    begun = time.process_time()
    _, errors = files.status()
    assert time.process_time() - begun < 5.0
    assert '99,980 more lines of ' in errors
    assert errors.count('\n') == 21


def test_only_the_last_attempt_counts_in_every_table(files: Files) -> None:
    first = [
        at(110, 'part began', 'a/buttons'),
        *(button(111, 1, 'fetch'), button(112, 2, 'avoid')),
        at(120, 'part began', 'a/buttons'),
        *(button(121, 1, 'go'), ended(125, 'a/buttons')),
        at(130, 'part began', 'a/teach'),
        *(learned(135, 'fetch', 'go'), learned(140, 'go'), ended(141, 'a/teach')),
        *(at(150, 'part began'), answer(151, 'easy', 1), answer(152, 'quick', 2)),
        *(at(160, 'part began'), answer(161, 'easy', 3), answer(162, 'easy', 4)),
        *(answer(163, 'quick', 5), ended(164, 'a/questions'), ended(165, 'a/questions')),
        *(at(170, 'part began', 'b/questions'), answer(171, 'easy', 7, 'b/questions')),
    ]
    files.write('000-p1.jsonl', began('p1'), *first)
    rows, errors = files.export('answers.csv', 'condition', 'item', 'value')
    assert errors == ''
    assert rows == [('a', 'easy', '4'), ('a', 'quick', '5'), ('b', 'easy', '7')]
    assert files.export('buttons.csv', 'rank', 'text')[0] == [('1', 'go')]
    assert files.export('options.csv', 'option')[0] == [('go',)]
    assert files.export('parts.csv', 'condition', 'part', 'sittings', 'why')[0] == [
        ('a', 'a/buttons', '2', 'finished'),
        ('a', 'a/teach', '1', 'finished'),
        ('a', 'a/questions', '2', 'finished'),
        ('b', 'b/questions', '1', ''),
    ]


def test_the_time_at_a_part_is_the_sum_of_all_sittings(files: Files) -> None:
    part = 'a/teach'
    files.write(
        *('000-p1.jsonl', began('p1')),
        *(at(200, 'part began', part), at(205, 'still there', part)),  # then the power failed
        *(at(300, 'part began', part), at(303, 'part left', part)),
        *(at(400, 'part began', part), ended(407, part, 'time is over')),
    )
    (row,), _ = files.export('parts.csv', 'began', 'seconds', 'sittings', 'why')
    assert row == ('200.0', '15.0', '3', 'time is over')


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=6,
)
WHOLE = [
    *(began('p1'), at(1, 'part began'), at(1, 'still there'), at(1, 'part left')),
    *(ended(1, 'a/teach'), answer(1, 'easy', 1), button(1, 1, 'go'), learned(1, 'go')),
    {'event': 'ended', 'time': 2.0},
]


@st.composite
def lines(draw: st.DrawFn) -> bytes:
    """Draw a line: an event, one in which a value or more is another, or anything."""
    if draw(st.integers(0, 9)) == 0:
        return draw(st.binary(max_size=60)).replace(b'\n', b'')
    event = dict(draw(st.sampled_from(WHOLE)))
    for key in draw(st.lists(st.sampled_from(sorted(event)), max_size=2)):
        event[key] = draw(VALUES)
    for key in draw(st.lists(st.sampled_from(sorted(event)), max_size=1)):
        del event[key]
    return json.dumps(event).encode(errors='surrogatepass')


def fits(line: bytes) -> bool:
    try:
        event_of(line.decode())
    except ValueError:
        return False
    return True


@pytest.mark.parametrize(
    'count', [40, pytest.param(5000, marks=[pytest.mark.slow, pytest.mark.timeout(3600)])]
)
def test_no_record_ends_in_a_traceback(files: Files, count: int) -> None:
    """Status and export answer within a second, and name every line left out."""
    path = files.write('000-p1.jsonl', began('p1'))
    files.export('answers.csv')  # what is imported once

    @settings(max_examples=count, deadline=None, suppress_health_check=list(HealthCheck))
    @given(st.lists(lines(), max_size=12))
    def generated(written: list[bytes]) -> None:
        path.write_bytes(b''.join(line + b'\n' for line in written))
        begun = time.process_time()
        found, errors = files.status()
        rows, _ = files.export('participants.csv')
        assert time.process_time() - begun < 1.0
        kept = sum(map(fits, written))
        assert len(found) == len(rows) <= bool(kept)
        named = errors.count(f' of {path} is left out: ')
        assert named == len(written) - kept or 'is left out: it is the record of' in errors

    generated()


FORMULAS = ["=cmd|' /C calc'!A0", '+1', '-2+3', '@x', '\t=1', '\r=1', '\uff1d1+1', "'=1", 'größer']


def test_a_spreadsheet_shows_text_in_place_of_formulas(files: Files) -> None:
    buttons = [button(110 + n, n, text) for n, text in enumerate(FORMULAS, start=1)]
    files.write('000-p1.jsonl', began('p1'), *buttons, learned(130, *FORMULAS))
    for table, column in (('buttons.csv', 'text'), ('options.csv', 'option')):
        rows, _ = files.export(table, column)
        assert rows == [*((f"'{text}",) for text in FORMULAS[:-1]), ('größer',)]
        shown = pd.read_csv(files.study / 'tables' / table)[column]
        assert [from_cell(text) for text in shown] == FORMULAS
    assert set(files.export('options.csv', 'return_shown')[0]) == {('-5.0',)}  # a number
    book, _ = files.export('codebook.csv', 'file', 'meaning')
    assert 'apostrophe' in dict(book)['buttons.csv']  # its last column
    path = files.study / 'tables' / 'buttons.csv'
    plain = path.read_bytes()
    assert files.run('export', '--excel')[0] == 0
    assert path.read_bytes() == b'\xef\xbb\xbf' + plain


@given(st.text())
def test_text_of_a_cell_is_read_back_as_it_was(text: str) -> None:
    assert from_cell(to_cell(text)) == text


def test_a_code_that_differs_only_in_case_is_asked_about_or_refused(
    files: Files, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    files.write('000-Simulated-1.jsonl', began('Simulated-1'))
    plan = ['study', str(files.path / 'plan.yaml'), '--study', str(files.study)]
    with free_domain_id() as number:  # where nothing runs already
        monkeypatch.setenv('ROS_DOMAIN_ID', str(number))
        assert main([*plan, '--simulate', '1']) == 2
        assert "'simulated-1' differs only in case from 'Simulated-1'" in capsys.readouterr().err
        words = ['-m', 'humanopts_teach', *plan, '--participant', 'SIMULATED-1']
        terminal = pexpect.spawn(sys.executable, words, encoding='utf-8', timeout=60.0)
        terminal.expect_exact('Continue as Simulated-1? [y/N]')
        terminal.sendline('n')
        terminal.expect_exact("use 'Simulated-1' to continue, or another code")
        terminal.expect(pexpect.EOF)
        terminal.close()
    assert terminal.exitstatus == 2
    assert len(list(files.study.glob('*.jsonl'))) == 1
