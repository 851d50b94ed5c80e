"""summary.json."""

import json
from pathlib import Path

from humanopts_learner.options.criteria import Thresholds
from humanopts_teach.evaluation.summary import (
    BagFacts,
    Execution,
    PlanningRow,
    Settings,
    Summary,
    SummaryError,
    write_json,
)
import pytest

ROW = PlanningRow('human', 0.99, 0.1, 0.2, 0.3, 7, 1e-9, True, -10.5, None)
SUMMARY = Summary(
    domain='taxi',
    settings=Settings(seed=4, thresholds=Thresholds(1.5, 0.05, 0.1), teacher_error_rate=0.02),
    options=(),
    planning=(ROW,),
    execution=Execution(100, 100, 0, -10.5),
    bag=BagFacts('bag', 1234, 30),
    offline=(),
)


def test_the_summary_has_the_agreed_form() -> None:
    assert SUMMARY.to_dict() == {
        'domain': 'taxi',
        'seed': 4,
        'options': [],
        'teaching': {
            'strategy': 'failures',
            'thresholds': {
                'return_delta': 1.5,
                'initiation_error': 0.05,
                'termination_error': 0.1,
            },
            'teacher_error_rate': 0.02,
            'budget': 150,
        },
        'planning': [
            {
                'action_set': 'human',
                'gamma': 0.99,
                'table_seconds': 0.1,
                'model_seconds': 0.2,
                'sweep_seconds': 0.3,
                'sweeps': 7,
                'residual': 1e-9,
                'converged': True,
                'mean_return': -10.5,
                'mean_discounted_return': None,
                'game_steps': 0,
                'episodes': 0,
                'mean_return_low': None,
                'mean_return_high': None,
                'fallbacks': None,
                'outcomes': {},
            }
        ],
        'execution': {'episodes': 100, 'successes': 100, 'fallbacks': 0, 'mean_return': -10.5},
        'bag': {'path': 'bag', 'messages': 1234, 'topics': 30},
        'offline': {'options': [], 'planning': []},
        'games': None,
    }


def test_a_written_summary_reads_back_equal_and_leaves_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / 'summary.json'
    path.write_text('old')
    write_json(path, SUMMARY.to_dict())
    assert json.loads(path.read_text()) == SUMMARY.to_dict()
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_that_is_missing_is_named(tmp_path: Path) -> None:
    path = tmp_path / 'nowhere' / 'summary.json'
    with pytest.raises(SummaryError, match=r'nowhere.*No such file'):
        write_json(path, {})


def test_a_number_that_is_not_one_is_refused_and_the_old_file_stays(tmp_path: Path) -> None:
    path = tmp_path / 'summary.json'
    path.write_text('old')
    with pytest.raises(ValueError, match='JSON'):
        write_json(path, {'value': float('nan')})
    assert path.read_text() == 'old'
