import importlib.util

import numpy as np
import pytest

from benchmarks.scaling import scaling_rows
from benchmarks.solvers import solvers
from benchmarks.taxi_case import TaxiCase


@pytest.mark.parametrize('side', [4, 5, 9])
def test_all_solvers_come_to_the_same_values(side: int) -> None:
    case = TaxiCase(side)
    solved = {solver.name: solver.solve(case).values for solver in solvers()}
    truth = solved['breadth-first search backwards']
    assert truth.min() < -4.0
    for name, values in solved.items():
        assert np.abs(values - truth).max() < 1e-9, name


def test_the_trees_say_what_the_shortest_ways_say() -> None:
    case = TaxiCase(6)
    for option, learned in zip(case.optimal, case.learned):
        rows = case.domain.feature_table()
        can = option.tables.initiation
        assert (learned.greedy_action(rows)[can] == option.tables.action[can]).all()
        assert (learned.can_start(rows) == can)[~case.domain.over()].all()


def test_every_solver_has_a_row_on_every_grid() -> None:
    heard = []
    rows = scaling_rows([4, 5], repeats=1, progress=lambda share, text: heard.append(share))
    assert [(row.side, row.n_states) for row in rows] == [
        (side, 20 * side * side) for side in (4, 5) for _ in solvers()
    ]
    assert all(row.seconds > 0 and row.error < 1e-9 for row in rows)
    for row in rows:
        assert (row.obtained_seconds > 0) == row.solver.startswith('options')
    assert rows[1].obtained_seconds > rows[0].obtained_seconds
    assert heard == sorted(heard)
    assert heard[-1] < 1


def test_quantecon_is_a_solver_where_it_is_installed() -> None:
    installed = importlib.util.find_spec('quantecon') is not None
    assert any('quantecon' in solver.name for solver in solvers()) == installed
