"""
How planning time grows with the size of the world: Taxi grids, solved in several ways.

With the paper's rewards a legal pickup costs nothing, so on large grids the best policy never
delivers: far from the destination it picks up and puts down for ever, at half the cost of
driving. Here a pickup costs 1 as every other step does, so the best policy delivers from every
state, and the two options of the paper lose nothing.

Solvers stand from the one that knows least of a grid to the one that knows most. Each is given
the exact transitions, and returns the values of all states and where the time went. A sweep over
all actions is also timed alone: on large grids it is memory traffic, so it stands beside a copy of
the bytes that it has to move.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
import importlib.util
import resource
import statistics
import time
import tracemalloc
from typing import Any, TypeVar

from humanopts_env.domains.base import Transitions
from humanopts_env.domains.table_domain import built_once
from humanopts_env.domains.tabular import distance_to, read_only
from humanopts_env.domains.taxi import LARGEST, Taxi
from humanopts_env.domains.taxi_reference import reference_options
from humanopts_learner.options.decision_tree import import_scikit_learn
from humanopts_learner.options.option import (
    option_from_table,
    TabularOption,
    tabulate,
)
from humanopts_learner.planning.exact import build_model, make_exact_plan
from humanopts_learner.planning.request import HUMAN, PlanRequest, PRIMITIVE
from humanopts_learner.planning.smdp import MultiTimeModel
from humanopts_learner.planning.value_iteration import compiled_sweep, solve_smdp
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from benchmarks.measure import (
    clocks,
    compare,
    in_turns,
    OnMeasured,
    part_of,
    ratios,
    Row,
    timed,
    Times,
)

SIDES = (5, 25, 50, 100)
LARGER = (200, 500)  # measured too where one still larger is asked for
QUICK = ((5, 10), 1)
YARDSTICK, SWEEP = 'primitive value iteration', 'one sweep over all actions'
GAMMA, TOLERANCE, MAX_SWEEPS = 0.99, 1e-6, 100_000
SECONDS = ('table_seconds', 'model_seconds', 'sweep_seconds', 'seconds')  # the last: of sums
TRAFFIC_FROM = 10_000  # states; smaller tables are in a cache next to the processor
LEAST_SWEEPS, SWEPT_STATES = 10, 1_000_000  # sweeps of a turn, or states of all its sweeps
SWEEP_BYTES = 6 * (4 + 8) + 8 + 8  # a state: 6 successors and rewards, its value before and after
COPIED = 2**28  # bytes that a copy moves: it reads half of them and writes half
SOLVING = 0.9  # about the share of the time before single sweeps
PROCESS_BYTES, BYTES_A_STATE = 2**30, 600  # of this process, and beside it for each state
Values = NDArray[np.float64]
Result = TypeVar('Result')
OPTIONS = ('go to passenger and pickup', 'go to destination and dropoff')


class PricedTaxi(Taxi):
    """Taxi in which a legal pickup costs 1, as every step but the delivery does."""

    @built_once
    def transitions(self) -> Transitions:
        paper = super().transitions()
        reward = np.where(paper.reward == 0.0, -1.0, paper.reward)
        return replace(paper, reward=read_only(reward))


class TaxiCase:
    """A square grid with the two options, as tables of shortest paths and as trees of these."""

    def __init__(self, side: int) -> None:
        """
        Prepare a grid.

        :raises DomainError: the side is not from 4 to 1000.
        """
        import_scikit_learn()  # which the first fit would, on the clock
        self.domain = domain = PricedTaxi(side, side)
        _, self.table_bytes, _ = traced(lambda: (domain.transitions(), domain.over()))
        rows, going = domain.feature_table(), ~domain.over()
        began = clocks()
        used = reference_options(domain, OPTIONS)
        self.optimal_time = clocks() - began  # for the shortest paths of both
        known = [used[name] for name in OPTIONS]
        self.optimal = [TabularOption.of_reference(option, domain.n_states) for option in known]
        self.learned = [  # none on large grids: the trees would have millions of rows
            option_from_table(
                domain,
                table,
                option.features,
                rows,
                (option.initiation, going, option.judged),
                participant='every state',
            )
            for option, table in zip(known, self.optimal)
            if side <= SIDES[-1]
        ]
        self.learned_time = clocks() - began  # for the paths, and for fitting


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
    solve: Callable[[TaxiCase], Solved]
    obtained: str = 'nothing'  # what it needs besides the transitions, and its origin
    cost: str = ''  # the time to obtain that, an attribute of the case
    largest: int = LARGEST  # side of a grid


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
    steps, _ = distance_to(rules, rules.terminated[:, :, 0], ~over)
    way = GAMMA ** np.maximum(steps - 1, 0)
    values = np.where(steps > 0, -(1 - way) / (1 - GAMMA) + way, 0.0)
    return Solved(values, 0.0, 0.0, time.perf_counter() - began, int(steps.max()))


def quantecon(case: TaxiCase) -> Solved:
    """Value iteration of the library quantecon, over sparse pairs of state and action."""
    began = time.perf_counter()
    problem = _discrete_dp(case)
    built = time.perf_counter()
    # its tolerance is epsilon * (1 - beta) / (2 * beta) between two sweeps
    epsilon = TOLERANCE * 2 * GAMMA / (1 - GAMMA)
    start = np.zeros(case.domain.n_states)
    result = problem.solve('value_iteration', start, epsilon, MAX_SWEEPS)
    swept = time.perf_counter() - built
    return Solved(np.asarray(result.v), 0.0, built - began, swept, int(result.num_iter))


def _discrete_dp(case: TaxiCase) -> Any:
    from quantecon.markov import DiscreteDP

    rules, over = case.domain.transitions(), case.domain.over()
    n_states, n_actions = rules.successor.shape[:2]
    successor = rules.successor[:, :, 0].copy()
    states = np.arange(n_states, dtype=np.int32)
    successor[over] = states[over, None]  # a task that is over stays so, and nothing follows
    reward = np.where(over[:, None], 0.0, rules.reward[:, :, 0])
    pairs = n_states * n_actions
    rows = csr_matrix(
        (np.ones(pairs), successor.ravel(), np.arange(pairs + 1)), shape=(pairs, n_states)
    )
    return DiscreteDP(
        reward.ravel(),
        rows,
        GAMMA,
        np.repeat(states, n_actions),
        np.tile(np.arange(n_actions, dtype=np.int32), n_states),
    )


GIVEN = 'shortest ways, as tables'
FITTED = 'trees fitted to the shortest ways from every state'
TREES = 'options by composition, trees evaluated'
ALIKE = 'that every step costs the same, without chance'
SOLVERS = (
    Solver('options by composition', composed, GIVEN, 'optimal_time'),
    Solver(TREES, composed_from_trees, FITTED, 'learned_time', SIDES[-1]),
    Solver('options by iterated models', iterated, GIVEN, 'optimal_time', SIDES[-1]),
    Solver('primitive value iteration', primitive),
    Solver('breadth-first search backwards', backwards, ALIKE),
    Solver("quantecon's value iteration", quantecon, largest=SIDES[-1]),
)


def solvers(side: int = SIDES[0]) -> list[Solver]:
    """Return the solvers of a grid that can run here: quantecon's where it is installed."""
    missing = [] if importlib.util.find_spec('quantecon') else [quantecon]
    return [one for one in SOLVERS if side <= one.largest and one.solve not in missing]


def sides_up_to(largest: int) -> tuple[int, ...]:
    """Return the sides of the grids that are measured, of which the last is this one."""
    return (*(side for side in SIDES + LARGER if side < largest), largest)


def memory_needed(side: int) -> int:
    """Return how many bytes of memory this process takes to measure a grid, about."""
    return PROCESS_BYTES + BYTES_A_STATE * 20 * side * side


def measure(progress: OnMeasured, sides: Sequence[int] = SIDES, repeats: int = 5) -> list[Row]:
    """
    Solve Taxi grids by every solver, in turns, so that a busy machine slows all of them alike.

    The true values are those of the breadth-first search, which sums up no series of roundings.
    Sides above those of ``SIDES`` are solved once by each solver that is left.

    :param repeats: turns of every solver; one more comes first, and is not counted.
    :raises DomainError: a side is not from 4 to 1000.
    """
    compiling = timed(compiled_sweep)[0]  # once, so that no solver's time has it
    rows: list[Row] = []
    total, done = sum(side * side for side in sides), 0
    for side in sides:
        case, named = TaxiCase(side), f'taxi {side} x {side}: '
        show = part_of(progress, named, done / total, side * side / total)
        rows += _solver_rows(show, case, side, 1 if side > SIDES[-1] else repeats + 1)
        show(SOLVING, 'single sweeps')
        rows += sweep_rows(case, side, repeats)
        done += side * side
    for row in rows:
        row['compile_seconds'] = compiling if row['solver'] == YARDSTICK else None
    return rows


def _solver_rows(progress: OnMeasured, case: TaxiCase, side: int, turns: int) -> list[Row]:
    """Return a row for each solver; the first of several turns is not counted."""
    chosen = solvers(side)
    runs: dict[str, list[tuple[Solved, Times]]] = {solver.name: [] for solver in chosen}
    memory: dict[str, int] = {}
    for turn in range(turns):
        for number, solver in enumerate(chosen):
            done = (turn + number / len(chosen)) / turns
            progress(SOLVING * done, solver.name)
            began = clocks()
            if turn:
                solved = solver.solve(case)
            else:
                solved, _, memory[solver.name] = traced(partial(solver.solve, case))
            times = np.array([solved.seconds, (clocks() - began)[1]])
            runs[solver.name].append((solved, times))
    runs = {name: found[turns > 1 :] for name, found in runs.items()}
    each = {name: np.array([times for _, times in found]) for name, found in runs.items()}
    truth = runs['breadth-first search backwards'][0][0].values
    yardstick, processor_yardstick = np.median(each[YARDSTICK], axis=0).tolist()
    rows = []
    for solver in chosen:
        found = [solved for solved, _ in runs[solver.name]]
        cost = getattr(case, solver.cost) if solver.cost else np.zeros(2)
        seconds = {
            name: statistics.median(getattr(one, name) for one in found) for name in SECONDS
        }
        rows.append(
            {
                'side': side,
                'n_states': len(truth),
                'solver': solver.name,
                'obtained': solver.obtained,
                'obtained_seconds': float(cost[0]),  # to get that, once, before all runs
                'obtained_processor_seconds': float(cost[1]),
                **seconds,
                'processor_seconds': float(np.median(each[solver.name][:, 1])),
                'sweeps': found[0].sweeps,
                'error': float(np.abs(found[0].values - truth).max()),  # reward units
                'yardstick': YARDSTICK,
                'yardstick_seconds': yardstick,
                'yardstick_processor_seconds': processor_yardstick,
                'samples': len(found),
                'ratio': seconds['seconds'] / yardstick,
                **ratios(each[solver.name], each[YARDSTICK]),
                'table_bytes': case.table_bytes,
                'memory_bytes': memory[solver.name],
                'bytes_a_state': (case.table_bytes + memory[solver.name]) / len(truth),
                'process_bytes': _process_bytes(),
            }
        )
    return rows


def sweep_rows(case: TaxiCase, side: int, repeats: int = 5) -> list[Row]:
    """
    Time single sweeps over all actions, ours beside a copy and quantecon's beside ours, in turns.

    A sweep has to read one successor and one reward of each action of each state and the old
    value, and to write the new one. The copy reads and writes as many bytes in all, in arrays
    that no cache holds; it is left out where the tables are in one.

    :param repeats: turns of each; one more comes first, and is not counted.
    """
    n_states = case.domain.n_states
    sweeps = max(LEAST_SWEEPS, SWEPT_STATES // n_states)
    model = build_model(case.domain, PRIMITIVE, (), GAMMA)
    size = SWEEP_BYTES * n_states
    origin, target = np.ones(COPIED // 16), np.empty(COPIED // 16)

    def swept() -> Times:
        ends: list[Times] = []  # of sweeps from values of 0

        def keep(sweep: int, residual: float) -> None:
            ends.append(clocks())

        spent, done = np.zeros(2), 0
        while done < sweeps:  # on small grids nothing changes any more after a few
            ends.clear()
            solve_smdp(model, 0.0, sweeps - done + 1, keep)
            spent += ends[-1] - ends[0]  # the first sweep is left out
            done += len(ends) - 1
        return spent / done

    works: dict[str, Callable[[], Times]] = {'ours': swept}
    if n_states >= TRAFFIC_FROM:
        copied = partial(np.copyto, target, origin)
        works['a copy'] = lambda: timed(copied) * size / COPIED
    if importlib.util.find_spec('quantecon') is not None:
        problem = _discrete_dp(case)

        def theirs() -> Times:
            began, values = clocks(), np.zeros(n_states)
            done = problem.operator_iteration(problem.bellman_operator, values, sweeps, 0.0)
            per_sweep: Times = (clocks() - began) / done
            return per_sweep

        works['quantecon'] = theirs
    times, found = dict(zip(works, in_turns([*works.values()], repeats))), []
    own, what = times['ours'], f'{SWEEP}, beside a copy'
    if 'a copy' in times:
        found.append(compare(what, own, 'a copy of as many bytes', times['a copy']))
    if 'quantecon' in times:
        found.append(compare("quantecon's sweep, beside ours", times['quantecon'], SWEEP, own))
    facts = {'sweep_bytes': size, 'process_bytes': _process_bytes()}
    shared = {'side': side, 'n_states': n_states, **facts}
    return [{**shared, 'solver': row.pop('what'), **row} for row in found]


def traced(work: Callable[[], Result]) -> tuple[Result, int, int]:
    """Return what the work returns, the bytes that it kept, and the most that it had at once."""
    tracemalloc.start()
    try:
        return work(), *tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()


def _process_bytes() -> int:
    """Return the most memory that this process had at once until now."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
