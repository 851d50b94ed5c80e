"""
Planning time by grid size: Taxi with several solvers.

With the paper's rewards, a legal pickup costs nothing. On large grids the best policy thus never
delivers: far from the destination it picks up and puts down forever, at half the cost of driving.
Here a pickup costs 1 like every other step, so the best policy delivers from every state, and
planning with the two options of the paper loses nothing.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property, partial
import tracemalloc
from typing import Any

from humanopts_env.domains.base import Transitions
from humanopts_env.domains.table_domain import built_once
from humanopts_env.domains.tabular import read_only
from humanopts_env.domains.taxi import Taxi
from humanopts_env.domains.taxi_reference import reference_options
from humanopts_learner.options.learned_option import TabularOption
from humanopts_learner.planning.exact_plan import build_model, make_exact_plan
from humanopts_learner.planning.request import HUMAN, PlanRequest, PRIMITIVE
from humanopts_learner.planning.solve import compiled_sweep, solve_smdp
import numpy as np
import pytest
from scipy.sparse import csr_matrix

OPTIONS = ('go to passenger and pickup', 'go to destination and dropoff')
GAMMA, TOLERANCE, MAX_SWEEPS = 0.99, 1e-6, 100_000
REPEATED = 100  # largest side for repetitions and for quantecon
SWEEPS = 10  # sweeps per round
SWEEP_BYTES = 6 * (4 + 8) + 8 + 8  # per state: 6 successors and rewards, old and new value


class PricedTaxi(Taxi):
    """Taxi in which a legal pickup costs 1, like every step except the delivery."""

    @built_once
    def transitions(self) -> Transitions:
        paper = super().transitions()
        reward = np.where(paper.reward == 0.0, -1.0, paper.reward)
        return replace(paper, reward=read_only(reward))

    @cached_property
    def options(self) -> list[TabularOption]:
        """The paper's options, as tables of shortest paths."""
        known = reference_options(self, OPTIONS).values()
        return [TabularOption.of_reference(option, self.n_states) for option in known]


@pytest.fixture(scope='module')
def grid(side: int) -> PricedTaxi:
    """A grid with all inputs of the solvers."""
    compiled_sweep()
    domain = PricedTaxi(side, side)
    assert len(domain.transitions().reward) == len(domain.over())
    return domain


def _planned(grid: PricedTaxi, action_set: str) -> int:
    """Make a plan and return its number of sweeps."""
    options = grid.options if action_set == HUMAN else ()
    limits: Any = {'gamma': GAMMA, 'tol': TOLERANCE, 'max_sweeps': MAX_SWEEPS}
    return make_exact_plan(grid, options, PlanRequest(action_set, **limits)).solution.sweeps


def _discrete_dp(grid: PricedTaxi) -> Any:
    """Return the problem for quantecon, as sparse state-action pairs."""
    markov = pytest.importorskip('quantecon.markov')
    rules, over = grid.transitions(), grid.over()
    n_states, n_actions = rules.successor.shape[:2]
    successor = rules.successor[:, :, 0].copy()
    states = np.arange(n_states, dtype=np.int32)
    successor[over] = states[over, None]  # terminal states are absorbing, with reward 0
    reward = np.where(over[:, None], 0.0, rules.reward[:, :, 0])
    pairs = n_states * n_actions
    rows = csr_matrix(
        (np.ones(pairs), successor.ravel(), np.arange(pairs + 1)), shape=(pairs, n_states)
    )
    actions = np.tile(np.arange(n_actions, dtype=np.int32), n_states)
    return markov.DiscreteDP(reward.ravel(), rows, GAMMA, np.repeat(states, n_actions), actions)


def _by_quantecon(grid: PricedTaxi) -> int:
    # quantecon's tolerance between sweeps is epsilon * (1 - beta) / (2 * beta)
    epsilon = TOLERANCE * 2 * GAMMA / (1 - GAMMA)
    start = np.zeros(grid.n_states)
    found = _discrete_dp(grid).solve('value_iteration', start, epsilon, MAX_SWEEPS)
    return int(found.num_iter)


SOLVERS: dict[str, Callable[[PricedTaxi], int]] = {
    'options by composition': partial(_planned, action_set=HUMAN),
    'primitive value iteration': partial(_planned, action_set=PRIMITIVE),
    "quantecon's value iteration": _by_quantecon,
}


@pytest.mark.parametrize('solver', SOLVERS)
def bench_plan(benchmark: Any, grid: PricedTaxi, side: int, solver: str) -> None:
    """Make complete plans: policies and models of the options, and sweeps."""
    solve, _ = SOLVERS[solver], grid.options  # cache the options before timing
    benchmark.group, benchmark.name = f'planning on Taxi {side} x {side}', solver
    if side > REPEATED:
        if solve is _by_quantecon:
            pytest.skip('takes too long')
        benchmark.extra_info['sweeps'] = benchmark.pedantic(solve, (grid,))
        return
    benchmark.extra_info['sweeps'] = benchmark.pedantic(solve, (grid,), rounds=5, warmup_rounds=1)
    tracemalloc.start()
    solve(grid)
    benchmark.extra_info['bytes a state'] = tracemalloc.get_traced_memory()[1] // grid.n_states
    tracemalloc.stop()


@pytest.mark.parametrize('swept', ['ours', 'a copy of as many bytes', "quantecon's"])
def bench_sweeps(benchmark: Any, grid: PricedTaxi, side: int, swept: str) -> None:
    """
    Sweep over all actions.

    For each state, a sweep has to read the old value and one successor and one reward per action,
    and to write the new value. The copy reads and writes the same number of bytes.
    """
    benchmark.group, benchmark.name = f'{SWEEPS} sweeps of Taxi {side} x {side}', swept
    start = np.zeros(grid.n_states)
    sweep: partial[Any]
    if swept == 'ours':
        model = build_model(grid, PRIMITIVE, (), GAMMA)
        sweep = partial(solve_smdp, model, 0.0, SWEEPS)
    elif swept == "quantecon's":
        problem = _discrete_dp(grid)
        step = problem.bellman_operator
        sweep = partial(problem.operator_iteration, step, start, SWEEPS, 0.0)
    else:
        origin = np.ones(SWEEPS * SWEEP_BYTES * grid.n_states // 16)
        target = np.empty_like(origin)
        sweep = partial(lambda: np.copyto(target, origin))
    benchmark.pedantic(sweep, rounds=5, warmup_rounds=1)
