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

MEANT = 3  # demonstrations of a detour after which it is asked about; fewer may be slips
REFUSALS = 3  # "not here" answers required as evidence for a leaf outside I
AS_LIKELY = 0.95  # a start succeeds at this share of the best policy's chance of a right end
ACCIDENT = 0.25  # an end shown less often than this share of the commonest one may be an accident
TOO_LONG = 2  # length of a path, relative to the shortest one


@dataclass(frozen=True)
class Failures:
    """The outcome of running an option from each of the S states of an enumerable domain."""

    candidate: Flags  # (S,) open, reachable, and in the learned I
    stuck: Flags  # (S,) candidates from which no end is reached that is or may be right
    unconfirmed: (
        Flags  # (S,) candidates with a planned end that nothing shows to be right or wrong
    )
    detour: (
        Flags  # (S,) candidates with a longer path than necessary, shown fewer than MEANT times
    )
    meant: Flags  # (S,) candidates with such a path, shown more often and not yet called right
    too_long: Flags  # (S,) those of either kind with a path of more than twice the length
    doubt: Flags  # (S,) open, reachable, and outside I without evidence (``uncertain``)
    times_shown: NDArray[np.int64]  # (S,) demonstrations with a state of equal features
    distance: NDArray[np.int32]  # (S,) fewest steps to such an end; -1: no known path
    nearer: Flags  # (S, A) first actions of shortest paths
    shortfall: Floats  # (S,) return of the best shortest path - return of the run; stuck: inf
    final: Ints  # (S,) state in which the run ends or is cut off

    @property
    def right(self) -> Flags:
        """Return (S,): candidates from which the run is right, as far as anyone knows."""
        return self.candidate & ~(self.stuck | self.unconfirmed | self.too_long)

    @property
    def possible(self) -> Flags:
        """Return (S,): candidates from which it is right if the person says so."""
        return self.candidate & ~(self.stuck | (self.too_long & self.detour))

    @property
    def failing(self) -> Flags:
        """Return (S,): stuck, on a detour, or in doubt."""
        return self.stuck | self.detour | self.doubt


@dataclass(frozen=True)
class Chances:
    """The chances of an option from each of the S states, if actions have several outcomes."""

    candidate: Flags  # (S,) as in ``Failures``
    right: Flags  # (S,) reaches an end like the shown ones about as surely and fast as can be
    possible: Flags  # (S,) the same, if all ends of a planned policy are right
    shortfall: Floats  # (S,) expected return of the best policy - that of the option


@dataclass(frozen=True)
class KnownEnds:
    """The ends of an option that were shown, and those that the person judged."""

    domain: ActableDomain
    features: Sequence[str]  # names of the chosen features
    demonstrations: Sequence[Demonstration]  # of one option, with the judged runs

    def like_shown(self, rows: Rows, over: Flags, last_reward: Floats | None = None) -> Flags:
        """
        Return (N,): whether states look like an end that was shown or called right.

        If all states can be listed, the chosen features and whether the task is over must be equal
        to those of such an end. If most demonstrations ended with the task over and one did not,
        or vice versa, its end may be a slip and counts only if repeated. Elsewhere few ends are
        ever equal: a state must agree in what most ends share, which is whether the task is over,
        the sign of the reward for which it is, and the values of the chosen features that are not
        continuous. With chance, another end of these counts if it was repeated: a fruit is eaten,
        but sometimes it is gone before.

        :param rows: (N, F) all features of the states.
        :param over: (N,) whether the task is over.
        :param last_reward: (N,) of the last step; None: not compared.
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

        A run that the person stopped has no end, and a run to an end that was shown is wrong
        because of its way there.

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
        """Return the chosen features, the trajectories, and what is compared of N states."""
        chosen = feature_columns(self.domain, self.features)
        taught = [demo for demo in shown(self.demonstrations) if demo.actions]
        return chosen, taught, np.column_stack([over, stacked(chosen, rows)])


def _ends(chosen: Sequence[FeatureColumn], runs: Sequence[Demonstration]) -> Floats:
    """Return (N, 1 + C): whether the task is over at the end of each run, and the features."""
    rows = [np.append(run.terminated, stacked(chosen, run.feature_rows[-1:])) for run in runs]
    return np.array(rows).reshape(len(runs), 1 + len(chosen))


def _times(rows: Floats, among: Floats) -> NDArray[np.int64]:
    """Return (N,): how often each row (N, C) is among others (M, C)."""
    _, inverse = np.unique(np.concatenate([rows, among]), axis=0, return_inverse=True)
    group = inverse.ravel()
    times: NDArray[np.int64] = np.bincount(group[len(rows) :], minlength=group.max(initial=0) + 1)
    return times[group[: len(rows)]]


def repeats(option: LearnedOption, domain: ActableDomain, run: Demonstration) -> bool:
    """Return whether an option would make a run again that the person judged."""
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
    demonstrated ones (``KnownEnds``). A planned policy (``goal.py``) takes the best path to
    the end most similar to the demonstrated ones; an end of another look is not known to be right,
    but may be, unless the person called it wrong. Its paths are never longer than necessary.

    :param demonstrations: those from which the option was learned, and the judged runs.
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
    """Return (S,): whether an end in each state is known to be right, and whether it may be."""
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

    From each state, the chance that its run reaches an end like the shown ones, and the number of
    steps if it does, are compared with those of the best policy by the domain's discount: the
    chance must be almost as large, with at most twice the steps. Both follow from the transitions,
    as does the return. They are not discounted: that its successes are fast does not make up for
    failures. An end that was shown much less often than another may be an accident, and counts for
    neither. Nor does the best policy aim at an end that was only called right, or pass through
    ends and "not here" states.
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
    Return the chance that a run reaches a right end, its mean steps if it does, and its return.

    All are (S,), and discounted by ``MAX_GAMMA`` only, so that every run ends.

    :param action: (S,) of its policy.
    :param ends: (S,) where it ends, besides where the task is over.
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

    They were not demonstrated, and their leaves of the tree have fewer than ``REFUSALS`` distinct
    "not here" answers, or answers that it rightly does not start: it is negative mainly because of
    ends of the option.
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
    """Return (S,): how many runs visit a state with equal chosen features."""
    chosen = feature_columns(domain, option.features)
    table = stacked(chosen, domain.feature_table())
    visited = [np.unique(stacked(chosen, run.feature_rows), axis=0) for run in runs]
    return _times(table, np.concatenate([table[:0], *visited]))
