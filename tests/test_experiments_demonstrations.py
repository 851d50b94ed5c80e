"""How many demonstrations an option takes: a real trial, and what is said of known results."""

import json
from typing import Any

from humanopts_learner.demonstrations import GOAL
import pytest

from experiments import demonstrations
from experiments.demonstrations import BUDGET, ERROR_RATE, UNTIL
from experiments.people import BagLesson, Study
from experiments.report import Mark

DROPOFF = 'go to destination and dropoff'


def test_people_teach_carefully_and_again_with_slips() -> None:
    trials = demonstrations.trials(Study(participants=2))
    people = [trial.parameters['person'] for trial in trials]
    rates = {person['group']: person['error_rate'] for person in people}
    assert rates == {'careful': 0.0, 'slips': ERROR_RATE}
    assert len({trial.key for trial in trials}) == len(trials) == 2 * 2 * 2 * 2 * 2
    lesson = BagLesson('/bag', 'p1', 'go', 'taxi', '{}', 'failures', 1, 'x')
    assert demonstrations.trials(Study(bags=(lesson,))) == []


def test_by_goal_every_option_of_taxi_is_right_after_a_few(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(demonstrations, 'LONGER', 1)
    (trial,) = (
        trial
        for trial in demonstrations.trials(Study(participants=1))
        if [trial.parameters[key] for key in ('domain', 'method', 'strategy')]
        == ['taxi', GOAL, 'failures']
        and trial.parameters['person']['group'] == 'slips'
    )
    rows = trial.compute(trial.parameters)
    assert json.loads(json.dumps(rows)) == rows
    assert len(rows) == 6
    for row in rows:
        assert 3 <= row[UNTIL[0]] <= 5
        assert 1 <= row[UNTIL[1]] <= 3
        assert row['accuracy when the criteria hold'] == 1.0


def done(met: list[int | None], right: list[int | None]) -> list[tuple[dict[str, Any], Any]]:
    """Return a trial of each of some people who taught one option by goal."""
    return [
        (
            {
                'domain': 'taxi',
                'method': GOAL,
                'strategy': 'failures',
                'person': {'group': 'careful', 'code': f'careful{number}'},
            },
            [{'option': DROPOFF, UNTIL[0]: one, UNTIL[1]: other}],
        )
        for number, (one, other) in enumerate(zip(met, right, strict=True))
    ]


@pytest.mark.parametrize(
    ('met', 'mark'),
    [([3, 4, 3], Mark.MET), ([3, 5, 7], Mark.UNDECIDED), ([9, 9, 10], Mark.MISSED)],
)
def test_the_goal_is_met_where_the_whole_interval_is_below(
    met: list[int | None], mark: Mark
) -> None:
    section = demonstrations.present(done(met, [1, 1, 1]))
    (found,) = section.comparisons
    assert found.mark is mark
    assert found.found.startswith('3 people: go to destination and dropoff ')


def test_a_lesson_that_did_not_get_there_is_counted_as_never() -> None:
    (row,) = demonstrations.summary_table(
        demonstrations.count_table(done([3, None, 5], [1, 2, None]))
    ).to_dict('records')
    assert (row['count'], row['until the criteria hold: never']) == (3, 1)
    assert (row['until the criteria hold: median'], row['until right for good: most']) == (4.0, 2)
    assert row['most in excess'] == 2
    assert row['until the criteria hold: most'] < BUDGET
