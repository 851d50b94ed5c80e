"""
Goal-based policies: optimal paths to an end like the demonstrated ones.

The paper learns the policy from the demonstrated actions. If the transitions of a domain are
known, the end of a demonstration is more informative than its path. So I and beta are learned from
the demonstrations (``learn.py``), but the policy is planned. From every state, it takes an optimal
path (``tabular.best_paths``) to an outcome where beta holds or the task is over.

With few demonstrations, beta holds in too many states, so an end must also resemble the
demonstrated ones. First, it must agree with most of them in whether the task is over. If
demonstrations pass nearer ends of this kind, the goal must be more specific. An option may have
several kinds of ends, such as a pickup and a delivery. So the last step of a path must change the
same nominal features as that of a demonstration and, if this is not enough, in the same direction:
a passenger gets in or out. If demonstrations still pass nearer ends, paths lead to the reachable
end that shares the most feature values with most demonstrated ends, unless demonstrations then
pass more ends.

Without chance, a path from a state that looks like an end leads to another end, unless the start
and the end of a demonstration look the same.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from humanopts_env.arrays import Flags, Floats, Ints
from humanopts_env.domains.base import action_index, EnumerableDomain, FeatureKind
from humanopts_env.domains.formulas import FeatureColumn, stacked
from humanopts_env.domains.tabular import best_paths, TIE
from humanopts_learner.demonstrations import Demonstration
import numpy as np

MOST = 0.8  # share of the demonstrations that counts as most; others may be slips
MAX_GAMMA = 0.999  # below 1, so that a longer path is worth less


@dataclass(frozen=True)
class Paths:
    """Optimal paths to ends, for S states and A actions."""

    value: Floats  # (S,) expected gamma**k for an end after k actions; 0: no path
    optimal: Flags  # (S, A) first actions of optimal paths


def paths_to_goal(
    domain: EnumerableDomain,
    trajectories: Sequence[Demonstration],
    chosen: Sequence[FeatureColumn],
    termination: Flags,
) -> Paths:
    """
    Plan the paths of an option.

    :param trajectories: demonstrations of the option, one or more.
    :param chosen: the chosen features.
    :param termination: (S,) whether beta holds.
    """
    table, stops = domain.transitions(), termination | domain.over()
    gamma = min(domain.gamma, MAX_GAMMA)

    columns = np.column_stack([domain.over(), stacked(chosen, domain.feature_table())])
    starts, last, ends = (
        np.array([domain.index(domain.decode(demo.states[at])) for demo in trajectories])
        for at in (0, -2, -1)
    )
    at_end = np.flatnonzero(termination & ~domain.over())
    if not table.deterministic or (columns[starts] == columns[ends]).all(axis=1).any():
        at_end = at_end[:0]  # a run may return to its start

    def paths(ends: Flags) -> Paths:
        """Return the paths to a subset of the outcomes (S, A, B) at which the option ends."""
        goal = stops[table.successor] & ends & (table.probability > 0)
        value, optimal = best_paths(table, goal, ~stops, gamma)
        if at_end.size:
            states = np.arange(len(stops))
            final = np.where(stops, states, table.successor[states, optimal.argmax(axis=1), 0])
            for _ in range(len(stops).bit_length()):
                final = final[final]
            after = table.successor[at_end, :, 0]
            back = (columns[final[after]] == columns[at_end][:, None]).all(axis=2)
            ahead = np.where(goal[at_end, :, 0], 1.0, value[after] * ~stops[after]) * ~back
            value[at_end] = gamma * ahead.max(axis=1)
            optimal[at_end] = ahead >= ahead.max(axis=1, keepdims=True) - TIE
        return Paths(value, optimal)

    def paths_to_best(rank: Ints) -> Paths:
        """Return the paths to the reachable ends with the highest rank (S, A, B)."""
        value, optimal = np.zeros(len(stops)), np.zeros(table.successor.shape[:2], dtype=np.bool_)
        for best in np.unique(rank[stops[table.successor]])[::-1]:
            found = paths(rank == best)
            fresh = (found.value > 0) & (value == 0)
            value[fresh], optimal[fresh] = found.value[fresh], found.optimal[fresh]
        return Paths(value, optimal)

    demonstrated = np.zeros(len(ends))
    for values_of_end in np.unique(columns[ends], axis=0):
        same = (columns == values_of_end).all(axis=1)
        at_same = same[ends]
        demonstrated[at_same] = paths(same[table.successor]).value[starts[at_same]]

    def passed(found: Paths) -> float:
        """Return the share of the demonstrations that pass a nearer end."""
        return float((found.value[starts] > demonstrated + TIE).mean())

    agreement = np.column_stack([_as_most(values, values[ends]) for values in columns.T])
    over_as_most = agreement[:, 0].astype(np.intp)[table.successor]
    if passed(nearest := paths_to_best(over_as_most)) <= 1 - MOST:
        return nearest
    nominal = [True, *(column.feature.kind is FeatureKind.NOMINAL for column in chosen)]
    kinds = columns[:, nominal]
    weights = 3.0 ** np.arange(sum(nominal))
    turns = np.sign(kinds[table.successor] - kinds[:, None, None])
    shown = np.sign(kinds[ends] - kinds[last])
    for change in (np.abs, np.positive):  # any change of the same features; the same direction
        same = np.isin(change(turns) @ weights, change(shown) @ weights)
        if passed(similar := paths_to_best(2 * over_as_most + same)) <= 1 - MOST:
            return similar
    rank = agreement @ [1 + len(chosen), *[1] * len(chosen)]
    return min(paths_to_best(rank[table.successor]), similar, key=passed)


def preferred_actions(
    domain: EnumerableDomain,
    trajectories: Sequence[Demonstration],
    chosen: Sequence[FeatureColumn],
    paths: Paths,
) -> Ints:
    """
    Return (S,): the optimal action demonstrated most often; on ties, the first.

    A demonstrated action counts in all states with equal chosen features.
    """
    shown = stacked(chosen, np.concatenate([demo.feature_rows[:-1] for demo in trajectories]))
    names = [name for demo in trajectories for name in demo.actions]
    actions = np.array([action_index(domain, name) for name in names])
    table = stacked(chosen, domain.feature_table())
    _, group = np.unique(np.concatenate([table, shown]), axis=0, return_inverse=True)
    of_state, of_step = np.split(group.ravel(), [len(table)])
    times = np.zeros((group.max() + 1, len(domain.actions)), dtype=np.intp)
    np.add.at(times, (of_step, actions), 1)
    preferred: Ints = (paths.optimal * (1 + times[of_state])).argmax(axis=1)
    return preferred


def _as_most(values: Ints, shown: Ints) -> Flags:
    """Return (S,): whether values equal the one that most demonstrated ends share, if any."""
    found, counts = np.unique(shown, return_counts=True)
    same: Flags = (values == found[counts.argmax()]) & (counts.max() >= MOST * len(shown))
    return same
