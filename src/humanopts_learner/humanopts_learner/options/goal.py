"""
The policy of an option by its goal: best ways to an end that looks like the shown ones.

The paper learns the policy from the actions that were shown. Where the transitions of a domain are
known, a demonstration says more by where it ends than by how it gets there: I and beta are learned
from the demonstrations (``learn.py``), and the policy is planned, not learned. From every state it
takes a best way (``tabular.best_ways``) to an outcome in which beta holds or the task is over.

Beta of few demonstrations holds in too many states, so an end must look like the shown ones, too.
First the task must be over there, or go on, as in most of them. If then demonstrations have passed
by nearer ends, the person means more: the ways lead to the end, among those that can be reached,
which has most of the values that the chosen features share in most of the shown ends.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from humanopts_env.arrays import Flags, Floats, Ints
from humanopts_env.domains.base import action_index, EnumerableDomain
from humanopts_env.domains.tabular import best_ways, TIE
from humanopts_learner.demonstrations import Demonstration
import numpy as np

MOST = 0.8  # of the demonstrations; so a slip in one of several hides nothing
MOST_GAMMA = 0.999  # at most: a longer way must be worth less


@dataclass(frozen=True)
class Ways:
    """Best ways to ends, from S states by A actions."""

    value: Floats  # (S,) expected gamma**k of an end by the k-th action; 0: there is no way
    optimal: Flags  # (S, A) the first actions of best ways


def ways_to_goal(
    domain: EnumerableDomain,
    trajectories: Sequence[Demonstration],
    chosen: Sequence[int],
    termination: Flags,
) -> Ways:
    """
    Plan the ways of an option.

    :param trajectories: that show the option, one or more.
    :param chosen: indices of the features that the option depends on.
    :param termination: (S,) where beta holds.
    """
    table, stops = domain.transitions(), termination | domain.over()
    gamma = min(domain.gamma, MOST_GAMMA)

    def ways(ends: Flags) -> Ways:
        """Return the ways to some of the states (S,) in which the option stops."""
        goal = (stops & ends)[table.successor] & (table.probability > 0)
        return Ways(*best_ways(table, goal, ~stops, gamma))

    def ways_to_best(rank: Ints) -> Ways:
        """Return the ways to those of highest rank (S,) among the stops that can be reached."""
        value, optimal = np.zeros(len(stops)), np.zeros(table.successor.shape[:2], dtype=np.bool_)
        for best in np.unique(rank[stops])[::-1]:
            found = ways(rank == best)
            fresh = (found.value > 0) & (value == 0)
            value[fresh], optimal[fresh] = found.value[fresh], found.optimal[fresh]
        return Ways(value, optimal)

    looks = np.column_stack([domain.over(), domain.feature_table()[:, chosen]])
    starts, ends = (
        np.array([domain.index(domain.decode(demo.states[at])) for demo in trajectories])
        for at in (0, -1)
    )
    alike = np.column_stack([_as_most(values, values[ends]) for values in looks.T])
    nearest = ways_to_best(alike[:, 0].astype(np.intp))
    passed = np.zeros(len(ends), dtype=np.bool_)
    for look in np.unique(looks[ends], axis=0):
        same = (looks == look).all(axis=1)
        there, by = ways(same), same[ends]
        passed[by] = nearest.value[starts[by]] > there.value[starts[by]] + TIE
    if passed.mean() <= 1 - MOST:
        return nearest
    return ways_to_best(alike @ [1 + len(chosen), *[1] * len(chosen)])


def preferred_actions(
    domain: EnumerableDomain,
    trajectories: Sequence[Demonstration],
    chosen: Sequence[int],
    ways: Ways,
) -> Ints:
    """
    Return (S,): of several best actions the one that was shown most often, then the first.

    What was shown in a state counts in all that are the same in the chosen features.
    """
    shown = np.concatenate([demo.feature_rows[:-1, chosen] for demo in trajectories])
    names = [name for demo in trajectories for name in demo.actions]
    actions = np.array([action_index(domain, name) for name in names])
    table = domain.feature_table()[:, chosen]
    _, group = np.unique(np.concatenate([table, shown]), axis=0, return_inverse=True)
    of_state, of_step = np.split(group.ravel(), [len(table)])
    times = np.zeros((group.max() + 1, len(domain.actions)), dtype=np.intp)
    np.add.at(times, (of_step, actions), 1)
    preferred: Ints = (ways.optimal * (1 + times[of_state])).argmax(axis=1)
    return preferred


def _as_most(values: Ints, shown: Ints) -> Flags:
    """Return (S,): which values are that of most shown ends; none, if they differ."""
    found, counts = np.unique(shown, return_counts=True)
    same: Flags = (values == found[counts.argmax()]) & (counts.max() >= MOST * len(shown))
    return same
