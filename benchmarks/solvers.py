"""
Ways to solve one Taxi grid, from the one that knows least of it to the one that knows most.

Each is given the exact transitions, and returns the values of all states and where the time went.
"""

from collections.abc import Callable
from dataclasses import dataclass
import importlib.util
from operator import attrgetter
import time

from humanopts_env.domains.base import Transitions
from humanopts_learner.options.option import option_tables
from humanopts_learner.planning.action_sets import HUMAN, PRIMITIVE, TabledOption
from humanopts_learner.planning.multi_time_models import MultiTimeModel
from humanopts_learner.planning.plan import plan_with_tables
from humanopts_learner.planning.value_iteration import solve_smdp
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, csr_matrix

from benchmarks.taxi_case import TaxiCase

GAMMA, TOLERANCE, MAX_SWEEPS = 0.99, 1e-6, 100_000
Values = NDArray[np.float64]


@dataclass(frozen=True)
class Solved:
    """The values that a solver found, and the seconds that it took."""

    values: Values  # (S,)
    table_seconds: float  # evaluating trees into tables
    model_seconds: float  # building what is swept over
    sweep_seconds: float
    sweeps: int  # or levels of a search

    @property
    def seconds(self) -> float:
        """All seconds."""
        return self.table_seconds + self.model_seconds + self.sweep_seconds


@dataclass(frozen=True)
class Solver:
    """A way to solve a grid."""

    name: str
    obtained: str  # what it is given besides the transitions, and where that comes from
    solve: Callable[[TaxiCase], Solved]
    cost: Callable[[TaxiCase], float] = lambda case: 0.0  # seconds to get what it is given


def composed(case: TaxiCase) -> Solved:
    """Plan with the options as tables; models by composing the successor table with itself."""
    plan = plan_with_tables(case.domain, HUMAN, case.optimal, GAMMA, TOLERANCE, MAX_SWEEPS)
    return Solved(
        plan.solution.values,
        0.0,
        plan.model_seconds,
        plan.sweep_seconds,
        plan.solution.sweeps,
    )


def composed_from_trees(case: TaxiCase) -> Solved:
    """Evaluate the options' trees in every state, then plan as ``composed``."""
    began = time.perf_counter()
    tabled = [
        TabledOption(option.name, option.max_steps, option_tables(option, case.domain))
        for option in case.learned
    ]
    seconds = time.perf_counter() - began
    plan = plan_with_tables(
        case.domain, HUMAN, tabled, GAMMA, TOLERANCE, MAX_SWEEPS, table_seconds=seconds
    )
    return Solved(
        plan.solution.values,
        plan.table_seconds,
        plan.model_seconds,
        plan.sweep_seconds,
        plan.solution.sweeps,
    )


def iterated(case: TaxiCase) -> Solved:
    """Build the options' models one step at a time, until every run has ended; then sweep."""
    domain, began = case.domain, time.perf_counter()
    columns = [_run_out(domain.transitions(), domain.over(), o) for o in case.optimal]
    reward, discount, successor = (np.stack(part) for part in zip(*columns))
    available = np.stack([o.tables.initiation & ~domain.over() for o in case.optimal])
    names = tuple(option.name for option in case.optimal)
    model = MultiTimeModel(names, reward.T, available.T, successor.T, discount.T)
    built = time.perf_counter()
    solution = solve_smdp(model, TOLERANCE, MAX_SWEEPS)
    swept = time.perf_counter() - built
    return Solved(solution.values, 0.0, built - began, swept, solution.sweeps)


def _run_out(
    rules: Transitions, over: NDArray[np.bool_], option: TabledOption
) -> tuple[Values, Values, NDArray[np.int32]]:
    """Run an option from all its states side by side."""
    reward, discount = np.zeros(len(over)), np.ones(len(over))
    successor = np.arange(len(over), dtype=np.int32)
    going = np.flatnonzero(option.tables.initiation & ~over)
    while len(going):
        state = successor[going]
        action = option.tables.action[state]
        reward[going] += discount[going] * rules.reward[state, action, 0]
        discount[going] *= np.where(rules.terminated[state, action, 0], 0.0, GAMMA)
        arrived = rules.successor[state, action, 0]
        successor[going] = arrived
        ended = option.tables.termination[arrived] | over[arrived] | (discount[going] == 0.0)
        going = going[~ended]
    return reward, discount, successor


def primitive(case: TaxiCase) -> Solved:
    """Sweep over all actions of all states."""
    plan = plan_with_tables(case.domain, PRIMITIVE, (), GAMMA, TOLERANCE, MAX_SWEEPS)
    return Solved(
        plan.solution.values,
        0.0,
        plan.model_seconds,
        plan.sweep_seconds,
        plan.solution.sweeps,
    )


def backwards(case: TaxiCase) -> Solved:
    """
    Search breadth-first from the deliveries backwards.

    It needs more than the transitions: that every step costs the same, so that the best way is a
    shortest one, and that no action has chance in it.
    """
    began = time.perf_counter()
    rules, over = case.domain.transitions(), case.domain.over()
    successor = rules.successor[:, :, 0]
    state, action = np.nonzero(~(rules.terminated[:, :, 0] | over[:, None]))
    arrow = csr_array(
        (np.ones(len(state), dtype=np.bool_), (successor[state, action], state)),
        shape=(len(over), len(over)),
    )
    frontier = np.flatnonzero((rules.terminated[:, :, 0] & ~over[:, None]).any(axis=1))
    built = time.perf_counter()
    steps = np.zeros(len(over), dtype=np.int64)  # to the delivery; 0: not known
    level = 0
    while len(frontier):
        level += 1
        steps[frontier] = level
        before = arrow.indices[_ranges(arrow.indptr, frontier)]
        before = before[(steps[before] == 0) & ~over[before]]
        frontier = np.unique(before)
    way = GAMMA ** np.maximum(steps - 1, 0)
    values = np.where(steps > 0, -(1 - way) / (1 - GAMMA) + way, 0.0)
    return Solved(values, 0.0, built - began, time.perf_counter() - built, level)


def _ranges(pointers: NDArray[np.integer], rows: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the places of all entries of some rows of a sparse array."""
    first, count = pointers[rows], pointers[rows + 1] - pointers[rows]
    skipped = np.repeat(first - np.concatenate([[0], np.cumsum(count)[:-1]]), count)
    return skipped + np.arange(int(count.sum()))


def quantecon(case: TaxiCase) -> Solved:
    """Value iteration of the library quantecon, over sparse pairs of state and action."""
    from quantecon.markov import DiscreteDP

    began = time.perf_counter()
    rules, over = case.domain.transitions(), case.domain.over()
    n_states, n_actions = rules.successor.shape[:2]
    successor = rules.successor[:, :, 0].copy()
    states = np.arange(n_states)
    successor[over] = states[over, None]  # a task that is over stays so, and nothing follows
    reward = np.where(over[:, None], 0.0, rules.reward[:, :, 0])
    pairs = n_states * n_actions
    rows = csr_matrix(
        (np.ones(pairs), successor.ravel(), np.arange(pairs + 1)), shape=(pairs, n_states)
    )
    problem = DiscreteDP(
        reward.ravel(),
        rows,
        GAMMA,
        np.repeat(states, n_actions),
        np.tile(np.arange(n_actions), n_states),
    )
    built = time.perf_counter()
    # its tolerance is epsilon * (1 - beta) / (2 * beta) between two sweeps
    epsilon = TOLERANCE * 2 * GAMMA / (1 - GAMMA)
    result = problem.solve('value_iteration', np.zeros(n_states), epsilon, MAX_SWEEPS)
    swept = time.perf_counter() - built
    return Solved(np.asarray(result.v), 0.0, built - began, swept, int(result.num_iter))


GIVEN, OPTIMAL = 'shortest ways, as tables', attrgetter('optimal_seconds')
SOLVERS = (
    Solver('options by composition', GIVEN, composed, OPTIMAL),
    Solver(
        'options by composition, trees evaluated',
        'trees fitted to the shortest ways from every state',
        composed_from_trees,
        attrgetter('learned_seconds'),
    ),
    Solver('options by iterated models', GIVEN, iterated, OPTIMAL),
    Solver('primitive value iteration', 'nothing', primitive),
    Solver(
        'breadth-first search backwards',
        'that every step costs the same, without chance',
        backwards,
    ),
)


def solvers() -> tuple[Solver, ...]:
    """Return all solvers that can run here: quantecon's where it is installed."""
    if importlib.util.find_spec('quantecon') is None:
        return SOLVERS
    return (*SOLVERS, Solver("quantecon's value iteration", 'nothing', quantecon))
