"""The states from which a learned option does not behave as demonstrated."""

from collections.abc import Sequence
from dataclasses import dataclass

from humanopts_env.arrays import Flags, Floats, Ints, Rows
from humanopts_env.domains.base import (
    ActableDomain,
    action_index,
    EnumerableDomain,
    FeatureKind,
    is_enumerable,
)
from humanopts_env.domains.formulas import feature_columns, FeatureColumn, stacked
from humanopts_env.domains.tabular import best_paths, distance_to, reachable
from humanopts_learner.demonstrations import Demonstration, GOAL, judged, Kind, shown
from humanopts_learner.options.decision_tree import encode_rows
from humanopts_learner.options.goal import MAX_GAMMA, MOST
from humanopts_learner.options.learned_option import LearnedOption, tabulate
from humanopts_learner.options.rollout import rollouts_from_everywhere, without_chance
import numpy as np
from numpy.typing import NDArray

MEANT = 3  # demonstrations of a detour before a question about it; fewer may be slips
REFUSALS = 3  # "not here" answers required as evidence for a leaf outside I
AS_LIKELY = 0.95  # a start succeeds at this share of the best policy's chance of a right end
ACCIDENT = 0.25  # an end shown less often, relative to the most common one, may be an accident
TOO_LONG = 2  # maximum length of a path, relative to the shortest one


@dataclass(frozen=True)
class Failures:
    """The outcome of running an option from each of the S states of an enumerable domain."""

    candidate: Flags  # (S,) open, reachable, and in the learned I
    stuck: Flags  # (S,) candidates from which no right or possibly right end is reached
    unconfirmed: (
        Flags  # (S,) candidates with a planned end that nothing shows to be right or wrong
    )
    detour: (
        Flags  # (S,) candidates with a longer path than necessary, shown fewer than MEANT times
    )
    meant: Flags  # (S,) candidates with such a path, shown more often and not yet called right
    too_long: Flags  # (S,) candidates of either kind with a path longer than ``TOO_LONG`` allows
    doubt: Flags  # (S,) open, reachable, and outside I without evidence (``uncertain``)
    times_shown: NDArray[np.int64]  # (S,) demonstrations with a state of equal features
    distance: NDArray[np.int32]  # (S,) fewest steps to a possibly right end; -1: no known path
    nearer: Flags  # (S, A) first actions of shortest paths
    shortfall: Floats  # (S,) return of the best shortest path - return of the run; stuck: inf
    final: Ints  # (S,) state in which the run ends or is cut off

    @property
    def right(self) -> Flags:
        """Return (S,): candidates from which the run is right, as far as known."""
        return self.candidate & ~(self.stuck | self.unconfirmed | self.too_long)

    @property
    def possible(self) -> Flags:
        """Return (S,): candidates from which the run is right if the person confirms it."""
        return self.candidate & ~(self.stuck | (self.too_long & self.detour))

    @property
    def failing(self) -> Flags:
        """Return (S,): stuck, on a detour, or in doubt."""
        return self.stuck | self.detour | self.doubt


@dataclass(frozen=True)
class Chances:
    """The success of an option from each of the S states, if actions have several outcomes."""

    candidate: Flags  # (S,) as in ``Failures``
    right: Flags  # (S,) reaches an end like the shown ones almost as reliably and fast as possible
    possible: Flags  # (S,) the same, if all ends of a planned policy are right
    shortfall: Floats  # (S,) expected return of the best policy - that of the option


@dataclass(frozen=True)
class KnownEnds:
    """The ends of an option that were shown or judged."""

    domain: ActableDomain
    features: Sequence[str]  # names of the chosen features
    demonstrations: Sequence[Demonstration]  # demonstrations and judged runs of one option

    def like_shown(self, rows: Rows, over: Flags, last_reward: Floats | None = None) -> Flags:
        """
        Return (N,): whether states look like an end that was shown or called right.

        If all states can be listed, a state must equal such an end in the chosen features and in
        whether the task is over. An end that differs from most in the latter may be a slip, and
        counts only if repeated. In other domains, few ends are equal. A state must then agree with
        the values that most ends share: whether the task is over, the sign of the last reward if
        it is, and the chosen features that are not continuous. With chance, a different end also
        counts if it was repeated: usually a fruit is eaten, but sometimes it disappears first.

        :param rows: (N, F) all features of the states.
        :param over: (N,) whether the task is over.
        :param last_reward: (N,) reward of the last step; None: not compared.
        """
        chosen, taught, states = self._compared(rows, over)
        certain = without_chance(self.domain)  # with chance, a right exam run may end anywhere
        runs = [run for run in judged(self.demonstrations) if run.actions and run.right]
        right = [run for run in runs if certain or not run.exam]
        ends = np.concatenate([_ends(chosen, taught), _ends(chosen, right)])
        mostly_over = ends[: len(taught), 0].mean() > 0.5 if taught else False
        if is_enumerable(self.domain):
            times, confirmed = (_times(states, part) for part in np.split(ends, [len(taught)]))
            return (times >= np.where(over == mostly_over, 1, 2)) | (confirmed > 0)
        kinds = [None, *(column.feature.kind for column in chosen)]
        compared = [kind is not FeatureKind.CONTINUOUS for kind in kinds]
        states, ends = states[:, compared], ends[:, compared]
        if last_reward is not None:
            shown_rewards = [run.rewards[-1] for run in (*taught, *right)]
            states = np.column_stack([states, over * np.sign(last_reward)])
            ends = np.column_stack([ends, ends[:, 0] * np.sign(shown_rewards)])
        agrees = np.ones(len(rows), dtype=np.bool_)
        for values, shown_values in zip(states.T, ends.T):
            found, counts = np.unique(shown_values, return_counts=True)
            if counts.max() >= MOST * len(ends):
                agrees &= values == found[counts.argmax()]
        return agrees if certain else agrees | (_times(states, ends) > 1)

    def called_wrong(self, rows: Rows, over: Flags) -> Flags:
        """
        Return (N,): whether states are equal, in the chosen features, to an end called wrong.

        A run that the person stopped has no end. A wrong run to a demonstrated end is wrong
        because of its path.

        :param rows: (N, F) all features of the states.
        :param over: (N,) whether the task is over.
        """
        chosen, taught, states = self._compared(rows, over)
        runs = [run for run in judged(self.demonstrations) if run.actions and not run.right]
        wrong = [run for run in runs if not run.stopped]
        called_wrong: Flags = (_times(states, _ends(chosen, wrong)) > 0) & (
            _times(states, _ends(chosen, taught)) == 0
        )
        return called_wrong

    def _compared(
        self, rows: Rows, over: Flags
    ) -> tuple[Sequence[FeatureColumn], list[Demonstration], Floats]:
        """Return the chosen features, the trajectories, and the compared values of N states."""
        chosen = feature_columns(self.domain, self.features)
        taught = [demo for demo in shown(self.demonstrations) if demo.actions]
        return chosen, taught, np.column_stack([over, stacked(chosen, rows)])


def _ends(chosen: Sequence[FeatureColumn], runs: Sequence[Demonstration]) -> Floats:
    """Return (N, 1 + C): whether the task is over at the end of each run, and the features."""
    rows = [np.append(run.terminated, stacked(chosen, run.feature_rows[-1:])) for run in runs]
    return np.array(rows).reshape(len(runs), 1 + len(chosen))


def _times(rows: Floats, among: Floats) -> NDArray[np.int64]:
    """Return (N,): how often each row (N, C) occurs among others (M, C)."""
    _, inverse = np.unique(np.concatenate([rows, among]), axis=0, return_inverse=True)
    group = inverse.ravel()
    times: NDArray[np.int64] = np.bincount(group[len(rows) :], minlength=group.max(initial=0) + 1)
    return times[group[: len(rows)]]


def repeats(option: LearnedOption, domain: ActableDomain, run: Demonstration) -> bool:
    """Return whether an option would repeat a run that the person judged."""
    rows = run.feature_rows
    starts = bool(option.can_start(rows[:1])[0])
    if not run.actions or not starts:
        return starts == bool(run.actions)
    actions = [action_index(domain, name) for name in run.actions]
    ends = option.ends(rows[1:])
    ended = run.stopped or run.terminated or ends[-1]
    return bool(ended and not ends[:-1].any() and (option.action(rows[:-1]) == actions).all())


def find_failures(
    option: LearnedOption,
    domain: EnumerableDomain,
    demonstrations: Sequence[Demonstration],
) -> Failures:
    """
    Run the option from every state of a deterministic domain.

    A taxi that drops its passenger at the wrong place has reached an end, but not one like the
    demonstrated ones (``KnownEnds``). A planned policy (``goal.py``) takes the best path to the
    end most similar to the demonstrated ones. If that end looks different, it may still be right,
    unless the person called it wrong. Planned paths are never longer than necessary.

    :param demonstrations: demonstrations from which the option was learned, and the judged runs.
    :raises OptionError: the option was not learned in this domain.
    """
    transitions, over, rows = domain.transitions(), domain.over(), domain.feature_table()
    table = tabulate(option, domain)
    known, possible = _ends_of(option, domain, demonstrations)
    runs = rollouts_from_everywhere(domain, table)
    successor = transitions.successor[:, :, 0]
    ends = (table.termination | over)[successor] | transitions.terminated[:, :, 0]
    distance, nearer = distance_to(transitions, ends & possible[successor] & ~over[:, None], ~over)
    askable = reachable(domain) & ~over
    candidate = askable & table.initiation
    reached = runs.reached & possible[runs.final]
    times_shown = _times_visited(option, domain, shown(demonstrations))
    called_right = [demo for demo in judged(demonstrations) if demo.right]
    longer = candidate & reached & (runs.steps > distance) & (option.method != GOAL)
    longer &= _times_visited(option, domain, called_right) == 0
    return Failures(
        candidate=candidate,
        stuck=candidate & ~reached,
        unconfirmed=candidate & reached & ~known[runs.final],
        detour=longer & (times_shown < MEANT),
        meant=longer & (times_shown >= MEANT),
        too_long=longer & (runs.steps > TOO_LONG * distance),
        doubt=askable & uncertain(option, rows, demonstrations),
        times_shown=times_shown,
        distance=distance,
        nearer=nearer,
        shortfall=np.where(
            reached, _best_return(domain, distance, nearer) - runs.total_reward, np.inf
        ),
        final=runs.final,
    )


def _ends_of(
    option: LearnedOption, domain: EnumerableDomain, demonstrations: Sequence[Demonstration]
) -> tuple[Flags, Flags]:
    """Return (S,) each: whether an end in a state is known to be right, and whether it may be."""
    ends, states = (
        KnownEnds(domain, option.features, demonstrations),
        (domain.feature_table(), domain.over()),
    )
    known = ends.like_shown(*states)
    return known, known | ((option.method == GOAL) & ~ends.called_wrong(*states))


def successes_by_chance(
    option: LearnedOption, domain: EnumerableDomain, demonstrations: Sequence[Demonstration]
) -> Chances:
    """
    Return where an option succeeds, if actions have several outcomes.

    From each state, the probability of an end like the demonstrated ones, and the mean number of
    steps to it, are compared with those of the best policy under the domain's discount. The
    probability must be almost as large, with at most twice the steps. All results follow from the
    transitions, without this discount, so that fast successes do not make up for failures. An end
    shown much less often than another may be an accident, and counts for neither policy.
    The best policy does not aim at ends that were only called right, and does not pass through
    ends or "not here" states.
    """
    table, over, tabular = domain.transitions(), domain.over(), tabulate(option, domain)
    candidate = reachable(domain) & ~over & tabular.initiation
    chosen = feature_columns(domain, option.features)
    states = np.column_stack([over, stacked(chosen, domain.feature_table())])
    times = _times(states, _ends(chosen, [d for d in shown(demonstrations) if d.actions]))
    refused = _ends(chosen, [d for d in shown(demonstrations) if not d.actions])
    known, possible = _ends_of(option, domain, demonstrations)
    barred = over | (times > 0) | known | (_times(states, refused) > 0)
    often = times >= ACCIDENT * times.max()
    aim, meant = known & often, often | (times == 0)
    goal = aim[table.successor] & (table.probability > 0)
    _, optimal = best_paths(table, goal, ~barred, min(domain.gamma, MAX_GAMMA))
    best, fewest, most = _expected(domain, optimal.argmax(axis=1), barred, aim)

    def compared(right: Flags) -> tuple[Flags, Floats]:
        """Return (S,): whether the option is almost as good, and its shortfall."""
        chance, steps, worth = _expected(domain, tabular.action, tabular.termination, right)
        fast = (steps <= TOO_LONG * fewest) | (best == 0)
        return candidate & (chance > 0) & (chance >= AS_LIKELY * best) & fast, most - worth

    return Chances(candidate, compared(known & meant)[0], *compared(possible & meant))


def _expected(
    domain: EnumerableDomain, action: Ints, ends: Flags, right: Flags
) -> tuple[Floats, Floats, Floats]:
    """
    Return the probability of a right end, the mean number of steps to it, and the return.

    All are (S,), and discounted by ``MAX_GAMMA`` only, so that every run ends.

    :param action: (S,) action of the policy.
    :param ends: (S,) whether a run ends, besides where the task is over.
    """
    from scipy.sparse import csc_array, eye  # slow to import
    from scipy.sparse.linalg import splu

    table, states = domain.transitions(), np.arange(domain.n_states)
    taken = states, action
    successor, probability = table.successor[taken], table.probability[taken]
    ended = (ends | domain.over())[successor] | table.terminated[taken]
    arrives = MAX_GAMMA * (probability * (ended & right[successor])).sum(axis=1)
    origin = np.broadcast_to(states[:, None], successor.shape)
    goes_on = csc_array(
        ((probability * ~ended).ravel(), (origin.ravel(), successor.ravel())),
        shape=(domain.n_states, domain.n_states),
    )
    solve = splu(eye(domain.n_states, format='csc') - MAX_GAMMA * goes_on).solve
    chance: Floats = solve(arrives)
    steps = solve(chance) / np.maximum(chance, np.finfo(float).tiny)
    return chance, steps, solve((probability * table.reward[taken]).sum(axis=1))


def _best_return(domain: EnumerableDomain, distance: NDArray[np.int32], nearer: Flags) -> Floats:
    """Return (S,): the largest return of a shortest path; -infinity: no path."""
    table = domain.transitions()
    reward, successor = table.reward[:, :, 0], table.successor[:, :, 0]
    best = np.full(len(distance), -np.inf)
    for steps in range(1, distance.max(initial=0) + 1):
        at = np.flatnonzero(distance == steps)
        after = best[successor[at]] if steps > 1 else 0.0
        best[at] = np.where(nearer[at], reward[at] + after, -np.inf).max(axis=1)
    return best


def uncertain(option: LearnedOption, rows: Rows, demonstrations: Sequence[Demonstration]) -> Flags:
    """
    Return (N,): whether rows (N, F) are outside I without evidence.

    Such rows were not demonstrated, and their leaves of the tree have fewer than ``REFUSALS``
    distinct answers that the option cannot start. Such leaves are negative mainly because of ends
    of the option.
    """
    seen = np.unique(_encoded(option, [demo.feature_rows for demo in demonstrations]), axis=0)
    refusals = [
        demo.feature_rows
        for demo in demonstrations
        if demo.kind is Kind.NOT_HERE or (demo.kind is Kind.JUDGED and demo.right)
        if not demo.actions
    ]
    refused = np.unique(_encoded(option, [rows[:0], *refusals]), axis=0)
    leaves = option.initiation.leaves(refused)
    answers = np.bincount(leaves.ravel(), minlength=len(option.initiation.left))
    X = _encoded(option, [rows])
    shown = {row.tobytes() for row in seen}
    fresh = np.array([row.tobytes() not in shown for row in X], dtype=np.bool_)
    few = (answers[option.initiation.leaves(X)] < REFUSALS).all(axis=1)
    return fresh & ~option.can_start(rows) & few


def _encoded(option: LearnedOption, parts: Sequence[Rows]) -> NDArray[np.float32]:
    return encode_rows(option.encoding, np.concatenate(parts)) + np.float32(0)  # no -0.0


def _times_visited(
    option: LearnedOption, domain: EnumerableDomain, runs: Sequence[Demonstration]
) -> NDArray[np.int64]:
    """Return (S,): the number of runs that visit a state with equal chosen features."""
    chosen = feature_columns(domain, option.features)
    table = stacked(chosen, domain.feature_table())
    visited = [np.unique(stacked(chosen, run.feature_rows), axis=0) for run in runs]
    return _times(table, np.concatenate([table[:0], *visited]))
