"""``humanopts reproduce battery``: plans in a world that cannot be simulated."""

import json
from pathlib import Path

from humanopts_teach.cli import main
import numpy as np
import pandas as pd
import pytest

from experiments import battery


def test_the_rule_delivers_more_than_chance_and_the_person_shows_what_the_choice_depends_on() -> (
    None
):
    options, column = battery.taught(1)
    assert column.startswith('battery:')
    by_rule = battery.drive(options, battery.by_rule, 20, 1)
    by_chance = battery.drive(options, battery.at_random, 20, 1)
    assert np.mean(by_rule) > 1.5 * np.mean(by_chance)


def test_a_lesson_is_reported_with_every_policy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(battery, 'EPISODES', 3)
    monkeypatch.setattr(battery, 'JUDGED', 2)
    assert main(['reproduce', 'battery', '--participants', '2', '--jobs', '1']) == 0
    found = json.loads((tmp_path / 'runs/reproduce-battery/battery.json').read_text())
    rows = found['tables']['battery-summary']
    assert [row['policy'] for row in rows] == [
        battery.RULE,
        battery.RANDOM,
        *[battery.MODELS, battery.Q_LEARNING] * 2,
    ]
    assert [row['lessons'] for row in rows] == [2] * 6


@pytest.mark.parametrize(('deliveries', 'verdict'), [(13.5, 'met'), (9.0, 'missed')])
def test_the_goals_are_compared_lesson_by_lesson(deliveries: float, verdict: str) -> None:
    plans, size = (battery.MODELS, battery.Q_LEARNING), {'states': 1.0, 'runs': 1.0}
    rows = [
        {'policy': policy, 'abstract states': kind, 'deliveries': value + 0.01 * lesson, **size}
        for lesson in range(5)
        for policy, kind, value in (
            (battery.RULE, '', 14.0),
            (battery.RANDOM, '', 6.5),
            *((policy, battery.SYMBOLS, 5.0) for policy in plans),
            *(
                (policy, battery.ASKED, deliveries)
                for policy in (battery.MODELS, battery.Q_LEARNING)
            ),
        )
    ]
    marks = [each.mark.value for each in battery.present(pd.DataFrame(rows)).comparisons]
    assert marks == [verdict, verdict, 'met'] * 2
