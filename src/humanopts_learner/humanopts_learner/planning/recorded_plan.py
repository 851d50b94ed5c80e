"""
Planning from recorded runs, in worlds that cannot be simulated.

Recorded runs of options are samples of their models, by the same rules as the runs of sampled
games (``planning.sampling``): every suffix of a run counts, over the abstract states of the action
set. A run also counts for an option relearned since, up to the step at which that option would
have ended, if it would have taken the recorded actions until then.

Samples become a policy by models and value iteration, or by SMDP Q-learning. The latter learns
from one run at a time, so it can also choose the options while the machine drives.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math
import time
from typing import Any

from humanopts_env.arrays import Floats, Ints
from humanopts_env.domains.base import ActableDomain, action_index
from humanopts_env.domains.described import can_simulate
from humanopts_env.seeding import generator
from humanopts_learner.option import Option
from humanopts_learner.option_runs import COMPLETE, OptionRun
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_learner.planning.action_set import ActionSet, Observation
from humanopts_learner.planning.exact_plan import Decision
from humanopts_learner.planning.interruption import OptionValues
from humanopts_learner.planning.request import (
    Clock,
    ignore_progress,
    PlanError,
    PlanRequest,
    Progress,
    Q,
)
from humanopts_learner.planning.sampled_plan import GreedyPolicy, SampledPlan, solve_sampled
from humanopts_learner.planning.sampling import SampleCounts, Samples, samples_of
from humanopts_learner.planning.solve import Solution
from humanopts_learner.qlearning import QTable, Rates
from humanopts_learner.run import RunStatus
import numpy as np

MIN_SAMPLES = 3  # recorded samples required for a pair of state and option to be available
MAX_MISSING = 20  # maximum length of ``RecordedPlan.missing``
DEFAULT_RATES = Rates(learning_rate=0.1, explore=0.3, averages=True)  # of ``OptionLearner``
REPLAYS = 50  # number of samples replayed after each run


@dataclass(frozen=True)
class Missing:
    """An option that can start in an abstract state, but has too few samples there."""

    option: str
    state: str  # feature values as text
    choices: int  # number of recorded choices in this state
    samples: int


@dataclass(frozen=True, kw_only=True)
class RecordedPlan(SampledPlan):
    """A plan from recorded runs."""

    missing: Sequence[Missing]  # most choices first


def check_learning(learning: str, domain: ActableDomain) -> None:
    """
    Check how a plan is learned from recorded runs: ``Q``, or empty for models.

    :raises PlanError: the method is unknown, or the domain can be simulated.
    """
    if learning not in ('', Q):
        raise PlanError(f'unknown learning {learning!r}; choose {Q!r}, or leave it empty')
    if learning and can_simulate(domain):
        raise PlanError(f'{domain.name} can be simulated: plan without learning')


def samples_of_run(actions: ActionSet, run: OptionRun, gamma: float) -> Samples | None:
    """
    Return the samples of a recorded run; None: the run does not count.

    A run is a sample of its option and, if the action set models them, of its primitive actions.
    """
    seen, count = actions.see_rows(run.rows), len(run.actions)
    moves = np.array([action_index(actions.domain, action) for action in run.actions])
    over = run.terminated & (np.arange(count) == count - 1)
    n_options, parts = len(actions.options), []
    if length := _length(actions, run, seen, moves):
        option, at = actions.names.index(run.option), np.arange(length)
        inside = seen.startable[at, option]
        model = np.where(inside, option, option + actions.first_fallback)
        parts.append((at, model, at == length - 1))
    if actions.first_fallback > n_options:
        parts.append((np.arange(count), n_options + moves, np.ones(count, dtype=np.bool_)))
    if not parts:
        return None
    at, model, ended = (np.concatenate(each) for each in zip(*parts))
    columns = (
        *(seen.states[at], model, np.ones(len(at), dtype=np.bool_)),
        *(np.array(run.rewards)[at], ended, over[at], seen.states[at + 1]),
    )
    return samples_of(list(zip(*(column[:, None] for column in columns))), gamma)


def _length(actions: ActionSet, run: OptionRun, seen: Observation, moves: Ints) -> int:
    """Return the number of steps that count as a run of the current option; 0: none."""
    named = {option.name: option for option in actions.options}
    option = named.get(run.option)
    if option is None or (
        isinstance(option, LearnedOption) and run.participant not in ('', option.participant)
    ):
        return 0
    index = actions.names.index(run.option)
    ends = np.flatnonzero(seen.ending[1:, index])
    length = int(ends[0]) + 1 if ends.size else len(moves) if run.status in COMPLETE else 0
    if run.status == RunStatus.REACHED.name and not ends.size:  # it would continue now
        return 0
    same = run.random_moves > 0 or (seen.wanted[:length, index] == moves[:length]).all()
    return length if same else 0


class OptionLearner:
    """
    SMDP Q-learning over abstract states, from one recorded run at a time.

    Every suffix of a run updates the value of its first state; then ``REPLAYS`` random samples of
    all runs are replayed. The same runs in the same order give the same values, offline and while
    the machine drives.

    :ivar actions: the action set.
    :ivar runs: number of runs that have changed the values.
    """

    def __init__(self, actions: ActionSet, gamma: float, rates: Rates) -> None:
        """Start with values of 0."""
        self.actions, self._gamma, self.runs = actions, gamma, 0
        self._known: list[tuple[Any, ...]] = []  # samples, as ``QTable.update`` takes them
        self._rng = generator(0, 'replays')
        self.table = QTable(actions.first_fallback, rates)

    @classmethod
    def of(
        cls,
        domain: ActableDomain,
        options: Sequence[Option],
        runs: Sequence[OptionRun],
        request: PlanRequest,
        rates: Rates = DEFAULT_RATES,
    ) -> 'OptionLearner':
        """
        Return a learner with the values of all recorded runs.

        :raises PlanError: as ``PlanRequest.resolved``.
        """
        resolved = replace(request, game_steps=0).resolved(domain, options, sampled=True)
        actions = ActionSet(domain, resolved.action_set, options, resolved.columns)
        learner = cls(actions, resolved.gamma, rates)
        for run in runs:
            learner.learn(run)
        return learner

    def learn(self, run: OptionRun) -> None:
        """Update the values with a run, if it counts."""
        samples = samples_of_run(self.actions, run, self._gamma)
        if samples is None:
            return
        self.runs += 1
        seen = self.actions.see_rows(run.rows)
        final = dict(zip(seen.states.tolist(), seen.startable))
        chosen = samples.option < self.actions.first_fallback
        columns = (each[chosen].tolist() for each in vars(samples).values())
        fresh = [(*sample, final[sample[-1]]) for sample in zip(*columns)]
        for sample in fresh:
            self.table.update(*sample)
        self._known += fresh
        if self._known:
            for at in self._rng.integers(len(self._known), size=REPLAYS).tolist():
                self.table.update(*self._known[at], again=True)

    def choose(self, state: Any, rng: np.random.Generator) -> Decision:
        """Return the next option; at the exploration rate, any option that can start."""
        seen = self.actions.observe_state(state)
        option = int(seen.fallback[0])
        if option < 0:
            option = self.table.choose(int(seen.states[0]), seen.startable[0], rng)
        return Decision(self.actions.names[option], option >= self.actions.first_fallback)

    def policy(self, request: PlanRequest) -> tuple[Solution, GreedyPolicy]:
        """Return the values of all options tried so far, and their greedy policy."""
        known = {state: n for state, n in self.table.visits.items() if n.any()}
        states = np.sort(np.array([*known], dtype=np.int64))
        shape = len(states), self.actions.first_fallback
        tried = np.array([known[state] > 0 for state in states.tolist()]).reshape(shape)
        worth = np.array([self.table.values[state] for state in states.tolist()]).reshape(shape)
        values: Floats = np.where(tried, worth, -np.inf)
        table = OptionValues(
            action_set=self.actions.action_set,
            names=self.actions.names[: self.actions.first_fallback],
            states=states,
            option_values=values,
            continuation_values=values,
            interruption_margin=request.sampling.interruption_margin,
            sampled=True,
            columns=self.actions.columns,
        )
        best = values.argmax(axis=1).astype(np.int32)
        return Solution(values.max(axis=1), best, 0, 0.0, True), GreedyPolicy(table)


def make_recorded_plan(
    domain: ActableDomain,
    options: Sequence[Option],
    runs: Sequence[OptionRun],
    request: PlanRequest,
    learner: OptionLearner | None = None,
    progress: Progress = ignore_progress,
    clock: Clock = time.perf_counter,
) -> RecordedPlan:
    """
    Plan from recorded runs.

    A pair of abstract state and option with fewer samples than ``request.sampling.min_samples`` is
    unavailable.

    :param learner: learner with the values to follow; None: use models and value iteration.
    :param progress: called with the stages models and sweeps.
    :raises PlanError: as ``PlanRequest.resolved``, or no run counts.
    """
    resolved = replace(request, game_steps=0).resolved(domain, options, sampled=True)
    actions = ActionSet(domain, resolved.action_set, options, resolved.columns)
    counts, began = SampleCounts(actions.modelled, actions.first_fallback), clock()
    counted, parts = [], []
    for number, run in enumerate(runs):
        progress('models', number / len(runs), 0, math.nan)
        samples = samples_of_run(actions, run, resolved.gamma)
        if samples is not None:
            counted.append(run)
            parts.append(vars(samples))
    if not parts and learner is None:
        names = ', '.join(repr(name) for name in actions.names[: actions.first_fallback])
        raise PlanError(
            f'no recorded run of {names} in {domain.name} counts: run them first, or let '
            'run_policy learn'
        )
    if parts:
        counts.add(Samples(*(np.concatenate([p[name] for p in parts]) for name in parts[0])))
    least = resolved.sampling.min_samples
    if learner is None:
        model = counts.model(least)
        modelled = clock()
        solution, policy = solve_sampled(actions, counts.states, model, resolved, progress)
    else:
        modelled, least = clock(), 1
        solution, policy = learner.policy(resolved)
    return RecordedPlan(
        domain=domain,
        action_set=resolved.action_set,
        gamma=resolved.gamma,
        names=actions.names,
        first_fallback=actions.first_fallback,
        actions=actions,
        solution=solution,
        policy=policy,
        unstick=resolved.unstick,
        game_steps=sum(len(run.actions) for run in counted),
        model_seconds=modelled - began,
        sweep_seconds=clock() - modelled,
        recorded_runs=len(counted),
        missing=_missing(actions, runs, counts, least, resolved.columns) if runs else [],
    )


def _missing(
    actions: ActionSet,
    runs: Sequence[OptionRun],
    counts: SampleCounts,
    least: int,
    columns: Sequence[str],
) -> list[Missing]:
    """Return the options with too few samples where a choice was due, most choices first."""
    rows = np.array(
        [
            row
            for run in runs
            for row in (run.features[0], *(() if run.terminated else run.features[-1:]))
        ]
    )
    seen, n_choices = actions.see_rows(rows), actions.first_fallback
    states, first, choices = np.unique(seen.states, return_index=True, return_counts=True)
    row_of = {state: row for row, state in enumerate(counts.states.tolist())}
    asked = {column.partition(':')[0] for column in columns}
    for option in actions.options:
        asked |= set(option.features) if isinstance(option, LearnedOption) else set()
    named = [
        (feature, f) for f, feature in enumerate(actions.domain.features) if feature.name in asked
    ]
    found = []
    for state, at, count in zip(states.tolist(), first.tolist(), choices.tolist()):
        known = row_of.get(state)
        samples = np.zeros(n_choices) if known is None else counts.counts[:n_choices, known]
        words = ', '.join(f'{each.name} {each.text(rows[at, f])}' for each, f in named)
        found += [
            Missing(actions.names[option], words, count, int(samples[option]))
            for option in np.flatnonzero(seen.startable[at] & (samples < least)).tolist()
        ]
    return sorted(found, key=lambda each: -each.choices)[:MAX_MISSING]
