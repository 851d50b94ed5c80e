"""Records of a study that other programs, crashes and people have changed, seen from outside."""

from collections.abc import Iterable, Mapping
import csv
import json
import os
from pathlib import Path
import sys
import time
from typing import Any

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
points: 7
items:
  - {name: easy, text: It was easy., low: not at all, high: very}
  - {name: quick, text: It was quick., low: not at all, high: very}
"""


class Files:
    """A plan and its folder of records, read by the command line."""

    def __init__(self, path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        self.path, self.study, self._capsys = path, path / 'study', capsys
        self.study.mkdir(exist_ok=True)
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

    def status(self) -> tuple[list[dict[str, Any]], str]:
        code, output, errors = self.run('status', '--json')
        assert code == 0
        return json.loads(output), errors

    def export(self, name: str, *more: str) -> tuple[list[dict[str, str]], str]:
        """Return the rows of a table that is exported, and the errors."""
        code, _, errors = self.run('export', *more)
        assert code == 0
        with (self.study / 'tables' / name).open(encoding='utf-8-sig', newline='') as file:
            return list(csv.DictReader(file)), errors


@pytest.fixture
def files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Files:
    """The files of a study without participants."""
    return Files(tmp_path, capsys)


def began(code: str, number: int = 0) -> dict[str, Any]:
    who = {'participant': code, 'number': number, 'simulated': False}
    return {'event': 'began', 'time': 100.0, 'study': 'st', 'order': ['a', 'b'], **who}


def at(seconds: float, event: str, part: str = 'a/questions', **more: Any) -> dict[str, Any]:
    where = {'part': part, 'condition': part.partition('/')[0]}
    if event.startswith('part'):
        more['kind'] = part.rpartition('/')[2]
    return {'event': event, 'time': seconds, **where, **more}


def ended(seconds: float, part: str, why: str = 'finished') -> dict[str, Any]:
    return at(seconds, 'part ended', part, why=why)


def answer(seconds: float, item: str, value: int, part: str = 'a/questions') -> dict[str, Any]:
    return at(seconds, 'answer', part, item=item, value=value, points=7)


def button(seconds: float, rank: int, text: str) -> dict[str, Any]:
    return at(seconds, 'button', 'a/buttons', domain='rooms', rank=rank, text=text)


def learned(seconds: float, *names: str) -> dict[str, Any]:
    numbers = {'demonstrations': 3, 'not_here': 1, 'return_shown': -5.0, 'return_learned': None}
    rows = [{'option': n, 'method': 'goal', 'criteria_met': True, **numbers} for n in names]
    return at(seconds, 'learned', 'a/teach', options=rows)


@pytest.mark.parametrize(
    'line',
    [
        pytest.param('', id='empty line'),
        pytest.param('{"event": "answer"', id='cut off'),
        pytest.param('[]', id='list'),
        pytest.param('{"event": ["began"], "time": 1}', id='kind of another type'),
        pytest.param('{"event": "sang", "time": 1.0}', id='unknown kind'),
        pytest.param(json.dumps({**answer(1, 'x', 3), 'part': None}), id='null'),
        pytest.param(json.dumps({**answer(1, 'x', 3), 'value': 3.5}), id='not whole'),
        pytest.param(json.dumps({**answer(1, 'x', 3), 'value': 8}), id='off the scale'),
        pytest.param(json.dumps({**answer(1, 'x', 3), 'value': True}), id='bool'),
        pytest.param(json.dumps({**answer(1, 'x', 3), 'value': 10**400}), id='huge'),
        pytest.param(json.dumps({**answer(1, 'x', 3), 'time': float('nan')}), id='NaN'),
        pytest.param(json.dumps({**answer(1, 'x', 3), 'time': '1'}), id='text'),
        pytest.param(json.dumps({**answer(1, '\ud800', 3)}), id='half a character'),
        pytest.param('[' * 50_000, id='nested'),
        pytest.param('{"event": "answer", "item": "\udcff"}', id='not UTF-8'),
        pytest.param(
            '{"condition": "", "event": "part began", "kind": "page", "time": 1}', id='p'
        ),
        pytest.param(json.dumps({**ended(1, 'a/teach'), 'why': 'bored'}), id='why'),
    ],
)
def test_a_line_that_is_no_event_is_named_and_not_counted(files: Files, line: str) -> None:
    path = files.write('000-x1.jsonl', began('x1'), line, answer(120, 'easy', 3))
    rows, errors = files.export('answers.csv')
    assert [(row['participant'], row['item'], row['value']) for row in rows] == [
        ('x1', 'easy', '3')
    ]
    assert f'line 2 of {path} is left out: ' in errors
    assert errors.count('\n') == 1
    found, errors = files.status()
    assert [row['participant'] for row in found] == ['x1']
    assert f'line 2 of {path}' in errors


def test_copies_and_empty_files_are_named_and_not_counted(files: Files) -> None:
    lines = began('p1'), answer(120, 'easy', 3)
    files.write('000-p1.jsonl', *lines)
    files.write('000-p1 (conflicted copy 2026-11-01).jsonl', *lines)
    files.write('000-p1-DESKTOP.jsonl', *lines)
    files.write('000-p1-LAPTOP.jsonl', *lines[1:])  # its first line is damaged
    files.write('p1.jsonl', *lines)
    files.write('002-p1.jsonl', {**began('p1'), 'number': 2})
    files.write('003-p3.jsonl')
    os.mkfifo(files.study / '004-p4.jsonl')
    (files.study / '005-p5.jsonl').mkdir()
    (files.study / '006-p6.jsonl').symlink_to(files.study / '000-p1.jsonl')
    files.write('1000-p1001.jsonl', began('p1001', 1000), answer(120, 'easy', 4))
    found, errors = files.status()
    assert [row['participant'] for row in found] == ['p1', 'p1001']
    assert errors.count('\n') == errors.count(' is left out: ') == 9
    rows, errors = files.export('answers.csv')
    assert [row['value'] for row in rows] == ['3', '4']
    assert errors.count('\n') == 9


@pytest.mark.parametrize('spoilt', ['damaged', 'a folder'])
def test_who_has_a_record_that_cannot_be_used_gets_no_second_one(
    files: Files, spoilt: str
) -> None:
    path = files.study / '000-p1.jsonl'
    if spoilt == 'a folder':
        path.mkdir()
    else:
        files.write(path.name, spoilt)
    folder, plan = StudyFolder(files.study), read_plan(files.path / 'plan.yaml')
    with pytest.raises(StudyError, match=r"'p1' has a record that cannot be used: .* is left out"):
        folder.enter(plan, 'p1')
    assert folder.enter(plan, 'p2').number == 1


def test_a_folder_that_is_none_is_named(files: Files) -> None:
    os.rmdir(files.study)
    code, _, errors = files.run('export')
    assert code == 2
    assert f'nobody has taken part yet in {files.study}' in errors
    assert not files.study.exists()
    files.study.write_text('no folder')
    for command in ('status', 'export', 'run'):
        code, _, errors = files.run(command)
        assert code == 2
        assert 'Not a directory' in errors
        assert errors.count('\n') == 1


def test_a_participant_without_a_beginning_is_still_one(files: Files) -> None:
    files.write('000-p1.jsonl', 'damaged', answer(120, 'easy', 3), {'event': 'ended', 'time': 130})
    (person,), errors = files.export('participants.csv')
    assert (person['participant'], person['number'], person['ended']) == ('p1', '0', 'yes')
    assert person['simulated'] == person['order'] == ''
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
        at(150, 'part began'),
        *(answer(151, 'easy', 1), answer(152, 'quick', 2)),
        at(160, 'part began'),
        *(answer(161, 'easy', 3), answer(162, 'easy', 4), answer(163, 'quick', 5)),
        *(ended(164, 'a/questions'), ended(165, 'a/questions')),
        at(170, 'part began', 'b/questions'),
        answer(171, 'easy', 7, 'b/questions'),
    ]
    files.write('000-p1.jsonl', began('p1'), *first)
    rows, errors = files.export('answers.csv')
    assert errors == ''
    assert [(row['condition'], row['item'], row['value']) for row in rows] == [
        ('a', 'easy', '4'),
        ('a', 'quick', '5'),
        ('b', 'easy', '7'),
    ]
    rows, _ = files.export('buttons.csv')
    assert [(row['rank'], row['text']) for row in rows] == [('1', 'go')]
    rows, _ = files.export('options.csv')
    assert [row['option'] for row in rows] == ['go']
    rows, _ = files.export('parts.csv')
    kept = [(row['condition'], row['part'], row['sittings'], row['why']) for row in rows]
    assert kept == [
        ('a', 'buttons', '2', 'finished'),
        ('a', 'teach', '1', 'finished'),
        ('a', 'questions', '2', 'finished'),
        ('b', 'questions', '1', ''),
    ]


def test_the_time_at_a_part_is_the_sum_of_all_sittings(files: Files) -> None:
    part = 'a/teach'
    files.write(
        *('000-p1.jsonl', began('p1')),
        *(at(200, 'part began', part), at(205, 'still there', part)),  # then the power failed
        *(at(300, 'part began', part), at(303, 'part left', part)),
        *(at(400, 'part began', part), ended(407, part, 'time is over')),
    )
    (row,), _ = files.export('parts.csv')
    found = float(row['began']), float(row['seconds']), row['sittings'], row['why']
    assert found == (200.0, 15.0, '3', 'time is over')


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


def check_generated(files: Files, content: Iterable[bytes]) -> None:
    """Check that status and export answer within a second, and name every line left out."""
    written = list(content)
    path = files.study / '000-p1.jsonl'
    path.write_bytes(b''.join(line + b'\n' for line in written))
    begun = time.process_time()
    found, errors = files.status()
    rows, _ = files.export('participants.csv')
    assert time.process_time() - begun < 1.0
    kept = [line for line in written if fits(line)]
    assert len(found) == len(rows) <= bool(kept)
    lost = len(written) - len(kept)
    named = errors.count(f' of {path} is left out: ')
    assert named == min(lost, 20) or f'{path} is left out: it is the record of' in errors


@pytest.mark.parametrize(
    'count', [40, pytest.param(5000, marks=[pytest.mark.slow, pytest.mark.timeout(3600)])]
)
def test_no_record_ends_in_a_traceback(files: Files, count: int) -> None:
    files.write('000-p1.jsonl', began('p1'))
    files.export('answers.csv')  # what is imported once

    @settings(max_examples=count, deadline=None, suppress_health_check=list(HealthCheck))
    @given(st.lists(lines(), max_size=12))
    def generated(content: list[bytes]) -> None:
        check_generated(files, content)

    generated()


FORMULAS = ["=cmd|' /C calc'!A0", '+1', '-2+3', '@x', '\t=1', '\r=1', '\uff1d1+1', "'=1", 'größer']


def test_a_spreadsheet_shows_text_in_place_of_formulas(files: Files) -> None:
    buttons = [button(110 + n, n, text) for n, text in enumerate(FORMULAS, start=1)]
    files.write('000-p1.jsonl', began('p1'), *buttons, learned(130, *FORMULAS))
    for table, column in (('buttons.csv', 'text'), ('options.csv', 'option')):
        rows, _ = files.export(table)
        assert [row[column] for row in rows] == [f"'{text}" for text in FORMULAS[:-1]] + ['größer']
        shown = pd.read_csv(files.study / 'tables' / table)[column]
        assert [from_cell(text) for text in shown] == FORMULAS
    assert {row['return_shown'] for row in rows} == {'-5.0'}  # a number
    assert "'=" in (files.study / 'tables' / 'buttons.csv').read_text('utf-8')
    book, _ = files.export('codebook.csv')
    (meaning,) = [row['meaning'] for row in book if row['file'] == 'buttons.csv'][-1:]
    assert 'apostrophe' in meaning


def test_a_byte_order_mark_is_written_for_excel_alone(files: Files) -> None:
    files.write('000-p1.jsonl', began('p1'), button(110, 1, 'größer'))
    path = files.study / 'tables' / 'buttons.csv'
    files.export('buttons.csv')
    plain = path.read_bytes()
    files.export('buttons.csv', '--excel')
    assert path.read_bytes() == b'\xef\xbb\xbf' + plain
    assert list(pd.read_csv(path)['text']) == ['größer']


@given(st.text())
def test_text_of_a_cell_is_read_back_as_it_was(text: str) -> None:
    assert from_cell(to_cell(text)) == text


def test_a_code_that_differs_only_in_case_is_asked_about_or_refused(
    files: Files, capsys: pytest.CaptureFixture[str]
) -> None:
    files.write('000-Simulated-1.jsonl', began('Simulated-1'))
    plan = ['study', str(files.path / 'plan.yaml'), '--study', str(files.study)]
    assert main([*plan, '--simulate', '1']) == 2
    assert "'simulated-1' differs only in case from 'Simulated-1'" in capsys.readouterr().err
    words = ['-m', 'humanopts_teach.cli', *plan, '--participant', 'SIMULATED-1']
    terminal = pexpect.spawn(sys.executable, words, encoding='utf-8', timeout=60.0)
    terminal.expect_exact('Go on as Simulated-1? [y/N]')
    terminal.sendline('n')
    terminal.expect_exact("give 'Simulated-1' to go on, or another code")
    terminal.expect(pexpect.EOF)
    terminal.close()
    assert terminal.exitstatus == 2
    assert len(list(files.study.glob('*.jsonl'))) == 1
