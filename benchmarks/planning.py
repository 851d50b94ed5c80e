"""
How planning time grows with the size of the world: Taxi grids, solved in several ways.

With the paper's rewards a legal pickup costs nothing, so on large grids the best policy never
delivers: far from the destination it picks up and puts down for ever, at half the cost of
driving. Here a pickup costs 1 as every other step does, so the best policy delivers from every
state, and the two options of the paper lose nothing.

Solvers stand from the one that knows least of a grid to the one that knows most. Each is given
the exact transitions, and returns the values of all states and where the time went.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
import importlib.util
from operator import attrgetter
import statistics
import time

from humanopts_env.domains.base import Transitions
from humanopts_env.domains.tabular import read_only
from humanopts_env.domains.taxi import Taxi
from humanopts_env.domains.taxi_reference import reference_options
from humanopts_learner.options.option import (
    option_from_table,
    TabularOption,
    tabulate,
)
from humanopts_learner.planning.exact import make_exact_plan
from humanopts_learner.planning.request import HUMAN, PlanRequest, PRIMITIVE
from humanopts_learner.planning.smdp import MultiTimeModel
from humanopts_learner.planning.value_iteration import solve_smdp
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, csr_matrix

from benchmarks.measure import clocks, OnMeasured, ratios, Row, since, Timed

SIDES = (5, 25, 50, 100)
QUICK = ((5, 10), 1)
YARDSTICK = 'primitive value iteration'
GAMMA, TOLERANCE, MAX_SWEEPS = 0.99, 1e-6, 100_000
SECONDS = ('table_seconds', 'model_seconds', 'sweep_seconds', 'seconds')  # the last: of sums
Values = NDArray[np.float64]
OPTIONS = ('go to passenger and pickup', 'go to destination and dropoff')


class PricedTaxi(Taxi):
    """Taxi in which a legal pickup costs 1, as every step but the delivery does."""

    @cached_property
    def _transitions(self) -> Transitions:
        paper = super()._transitions
        reward = np.where(paper.reward == 0.0, -1.0, paper.reward)
        return replace(paper, reward=read_only(reward))


class TaxiCase:
    """A square grid with the two options, as tables of shortest paths and as trees of these."""

    def __init__(self, side: int) -> None:
        """
        Prepare a grid.

        :raises DomainError: the side is not from 4 to 1000.
        """
        importlib.import_module('sklearn.tree')  # which the first fit would, on the clock
        self.domain = domain = PricedTaxi(side, side)
        rows, going = domain.feature_table(), ~domain.over()
        domain.transitions()
        began = clocks()
        used = reference_options(domain, OPTIONS)
        self.optimal_time = since(began)  # for the shortest paths of both
        known = [used[name] for name in OPTIONS]
        self.optimal = [TabularOption.of_reference(option, domain.n_states) for option in known]
        self.learned = [
            option_from_table(
                domain,
                table,
                option.features,
                rows,
                (option.initiation, going, option.judged),
                participant='every state',
            )
            for option, table in zip(known, self.optimal)
        ]
        self.learned_time = since(began)  # for the paths, and for fitting


@dataclass(frozen=True)
class Solved:
    """The values that a solver found, and the seconds that it took."""

    values: Values  # (S,)
    table_seconds: float  # evaluating trees into tables
    model_seconds: float  # building the models
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
    obtained: str  # what the solver needs besides the transitions, and its origin
    solve: Callable[[TaxiCase], Solved]
    cost: Callable[[TaxiCase], Timed] = lambda case: Timed(0.0, 0.0)  # to obtain that


def _planned(
    case: TaxiCase, action_set: str, options: Sequence[TabularOption], table_seconds: float = 0.0
) -> Solved:
    plan = make_exact_plan(
        case.domain,
        options,
        PlanRequest(action_set, gamma=GAMMA, tol=TOLERANCE, max_sweeps=MAX_SWEEPS),
    )
    return Solved(
        plan.solution.values,
        table_seconds,
        plan.model_seconds,
        plan.sweep_seconds,
        plan.solution.sweeps,
    )


def composed(case: TaxiCase) -> Solved:
    """Plan with the options as tables; models by composing the successor table with itself."""
    return _planned(case, HUMAN, case.optimal)


def composed_from_trees(case: TaxiCase) -> Solved:
    """Evaluate the options' trees in every state, then plan as ``composed``."""
    began = time.perf_counter()
    tabled = [tabulate(option, case.domain) for option in case.learned]
    return _planned(case, HUMAN, tabled, time.perf_counter() - began)


def iterated(case: TaxiCase) -> Solved:
    """Build the options' models one step at a time, until every run has ended; then sweep."""
    domain, began = case.domain, time.perf_counter()
    columns = [_run_out(domain.transitions(), domain.over(), o) for o in case.optimal]
    reward, discount, successor = (np.stack(part) for part in zip(*columns))
    available = np.stack([o.initiation & ~domain.over() for o in case.optimal])
    names = tuple(option.name for option in case.optimal)
    model = MultiTimeModel(names, reward.T, available.T, successor.T, discount.T)
    built = time.perf_counter()
    solution = solve_smdp(model, TOLERANCE, MAX_SWEEPS)
    swept = time.perf_counter() - built
    return Solved(solution.values, 0.0, built - began, swept, solution.sweeps)


def _run_out(
    rules: Transitions, over: NDArray[np.bool_], option: TabularOption
) -> tuple[Values, Values, NDArray[np.int32]]:
    """Run an option from all its states side by side."""
    reward, discount = np.zeros(len(over)), np.ones(len(over))
    successor = np.arange(len(over), dtype=np.int32)
    going = np.flatnonzero(option.initiation & ~over)
    while len(going):
        state = successor[going]
        action = option.action[state]
        reward[going] += discount[going] * rules.reward[state, action, 0]
        discount[going] *= np.where(rules.terminated[state, action, 0], 0.0, GAMMA)
        arrived = rules.successor[state, action, 0]
        successor[going] = arrived
        ended = option.termination[arrived] | over[arrived] | (discount[going] == 0.0)
        going = going[~ended]
    return reward, discount, successor


def primitive(case: TaxiCase) -> Solved:
    """Sweep over all actions of all states."""
    return _planned(case, PRIMITIVE, ())


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


GIVEN, OPTIMAL = 'shortest ways, as tables', attrgetter('optimal_time')
SOLVERS = (
    Solver('options by composition', GIVEN, composed, OPTIMAL),
    Solver(
        'options by composition, trees evaluated',
        'trees fitted to the shortest ways from every state',
        composed_from_trees,
        attrgetter('learned_time'),
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


def measure(progress: OnMeasured, sides: Sequence[int] = SIDES, repeats: int = 5) -> list[Row]:
    """
    Solve Taxi grids by every solver, in turns, so that a busy machine slows all of them alike.

    The true values are those of the breadth-first search, which sums up no series of roundings.

    :param repeats: turns of every solver; one more comes first, and is not counted.
    :raises DomainError: a side is not from 4 to 1000.
    """
    rows, total, done = [], sum(side * side for side in sides), 0
    for side in sides:
        case, chosen = TaxiCase(side), solvers()
        runs: dict[str, list[Solved]] = {solver.name: [] for solver in chosen}
        times: dict[str, list[Timed]] = {solver.name: [] for solver in chosen}
        for turn in range(repeats + 1):
            for solver in chosen:
                share = turn / (repeats + 1) * side * side
                progress((done + share) / total, f'taxi {side} x {side}: {solver.name}')
                began = clocks()
                solved = solver.solve(case)
                processor = since(began).processor
                if turn:
                    runs[solver.name].append(solved)
                    times[solver.name].append(Timed(solved.seconds, processor))
        truth = runs['breadth-first search backwards'][0].values
        yardstick = _median('seconds', runs[YARDSTICK])
        processor_yardstick = _median('processor', times[YARDSTICK])
        for solver in chosen:
            timed, cost = runs[solver.name], solver.cost(case)
            seconds = {name: _median(name, timed) for name in SECONDS}
            rows.append(
                {
                    'side': side,
                    'n_states': len(truth),
                    'solver': solver.name,
                    'obtained': solver.obtained,
                    'obtained_seconds': cost.seconds,  # to get that, once, before all runs
                    'obtained_processor_seconds': cost.processor,
                    **seconds,
                    'processor_seconds': _median('processor', times[solver.name]),
                    'sweeps': timed[0].sweeps,
                    'error': float(np.abs(timed[0].values - truth).max()),  # reward units
                    'yardstick': YARDSTICK,
                    'yardstick_seconds': yardstick,
                    'yardstick_processor_seconds': processor_yardstick,
                    'samples': repeats,
                    'ratio': seconds['seconds'] / yardstick,
                    **ratios(times[solver.name], times[YARDSTICK]),
                }
            )
        done += side * side
    return rows


def _median(field: str, runs: Sequence[Solved] | Sequence[Timed]) -> float:
    return float(statistics.median(getattr(run, field) for run in runs))
