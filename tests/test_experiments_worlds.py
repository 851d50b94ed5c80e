"""Lessons in environments that are replayed, as ``humanopts reproduce worlds`` gives them."""

import json
from pathlib import Path

from humanopts_teach.cli import main
import pandas as pd
import pytest

from experiments import worlds
from experiments.report import Mark


def test_a_lesson_is_taught_judged_and_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(worlds, 'CASES', {'FourRooms': worlds.CASES['FourRooms']})
    monkeypatch.setattr(worlds, 'PLAYS', {})
    monkeypatch.setattr(worlds, 'LEARNERS', 0)
    monkeypatch.chdir(tmp_path)
    assert main(['reproduce', 'worlds', '--participants', '2', '--jobs', '1']) == 0
    folder = tmp_path / 'runs/reproduce-worlds'
    (row,) = json.loads((folder / 'worlds.json').read_text())['tables']['worlds-summary']
    assert (row['option'], row['lessons'], row['most demonstrations']) == ('go to the goal', 2, 3)
    assert row['success'] > 0.95
    assert 'FourRooms' in (folder / 'report.html').read_text()


def test_an_option_is_judged_by_the_end_that_the_teacher_reaches() -> None:
    """In MiniGrid it must not fall into lava, although the task is over there, too."""
    domain = worlds.world('MiniGrid-LavaGapS5-v0')
    starts = worlds.starts_of(domain, 'go to the goal', 1, 10)
    assert all(steps > 0 for _, steps in starts)
    (option,) = worlds._taught(domain, worlds.Case('', 2, 0.9), 1)
    assert worlds.success(option, domain, starts) > 0.8

    class Forward:
        name, max_steps = option.name, 9

        def can_start(self, rows: pd.DataFrame) -> object:
            return option.can_start(rows) | True

        def action(self, rows: pd.DataFrame) -> object:
            return option.action(rows) * 0 + 2

        def ends(self, rows: pd.DataFrame) -> object:
            return option.ends(rows) & False

    assert worlds.success(Forward(), domain, starts) < 0.5


def test_segments_of_whole_plays_are_demonstrations(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(worlds, 'PLAYS', {'taxi': 4})
    monkeypatch.setattr(worlds, 'STARTS', 20)
    rows = worlds.teach_by_whole_plays({'domain': 'taxi', 'lesson': 1, 'seed': 1})
    assert [row['demonstrations'] for row in rows] == [4, 4]
    assert all(0 < row[name] <= 1 for row in rows for name in ('success', 'separate'))


def test_goals_are_decided_by_the_interval_over_lessons() -> None:
    lessons = [('FourRooms', 1.0)] * 3 + [('LavaCrossingS9N2', 0.5)] * 3 + [('Acrobot', 0.92)]
    rows = pd.DataFrame([{'case': case, 'option': 'a', 'success': s} for case, s in lessons])
    marks = [each.mark for each in worlds.present(rows.assign(demonstrations=1)).comparisons]
    assert marks == [Mark.MET, Mark.MISSED, Mark.UNDECIDED]
