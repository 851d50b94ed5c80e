"""Exact tables of domains: reachability, shortest paths, steps in many games."""

from typing import Any, TypeVar

from humanopts_env.arrays import Flags, Floats, Ints
from humanopts_env.domains.base import EnumerableDomain, feature_columns, Transitions
import numpy as np
from numpy.typing import NDArray

Scalar = TypeVar('Scalar', bound=np.generic)
TIE = 1e-12  # actions whose values differ by less are equally good


def read_only(array: NDArray[Scalar]) -> NDArray[Scalar]:
    """Return the same array, made read-only so that it can be shared."""
    array.setflags(write=False)
    return array


def feature_column(domain: EnumerableDomain, name: str) -> Floats:
    """Return (S,): the value of one feature in every state."""
    values: Floats = domain.feature_table()[:, feature_columns(domain, [name])[0]]
    return values


def reachable(domain: EnumerableDomain) -> Flags:
    """
    Return (S,): whether an episode can reach each state from the start states.

    Nothing is reached through a state where the task is over.
    """
    transitions, over = domain.transitions(), domain.over()
    found = np.zeros(domain.n_states, dtype=np.bool_)
    frontier = domain.start_states()
    while frontier.size:
        found[frontier] = True
        going = frontier[~over[frontier]]
        there = transitions.successor[going][transitions.probability[going] > 0]
        frontier = np.unique(there[~found[there]])
    return found


def distance_to(
    transitions: Transitions, goal: Flags, allowed: Flags
) -> tuple[NDArray[np.int32], Flags]:
    """
    Find the shortest ways to a goal by breadth-first search backwards from it.

    :param transitions: of a deterministic domain.
    :param goal: (S, A), the transitions that reach the goal, taken from allowed states only.
    :param allowed: (S,), the states that a path may visit before its last action.
    :return: distance (S,), the fewest actions including the one that reaches the goal, -1 where
        the state is not allowed or has no way; optimal (S, A), the actions of shortest ways.
    :raises ValueError: the transitions are not deterministic.
    """
    from scipy.sparse import csr_array  # slow to import

    if not transitions.deterministic:
        raise ValueError('shortest ways need transitions with one outcome for each action')
    successor = transitions.successor[:, :, 0]
    n_states, n_actions = successor.shape
    reaching = (goal & allowed[:, None]).any(axis=1)
    distance = np.where(reaching, 1, -1).astype(np.int32)
    origin = np.repeat(np.arange(n_states, dtype=np.int32), n_actions)
    step = np.ones(origin.size, dtype=np.bool_), (successor.ravel(), origin)
    before = csr_array(step, shape=(n_states, n_states))  # row: a state, columns: its predecessors
    frontier = np.flatnonzero(reaching)
    for steps in range(2, n_states + 2):
        previous = np.unique(before[frontier].indices)
        frontier = previous[allowed[previous] & (distance[previous] < 0)]
        if not frontier.size:
            break
        distance[frontier] = steps
    optimal = (distance[successor] == distance[:, None] - 1) & (distance > 1)[:, None]
    optimal |= goal & (distance == 1)[:, None]
    return distance, optimal


def best_ways(
    transitions: Transitions, goal: Flags, allowed: Flags, gamma: float
) -> tuple[Floats, Flags]:
    """
    Find the best ways to a goal, with chance or without, by value iteration until nothing changes.

    :param goal: (S, A, B), the outcomes that reach the goal.
    :param allowed: (S,), the states that a way may visit between its first and its last step.
    :param gamma: below 1; without chance, the best ways are the shortest.
    :return: value (S,), the expected gamma**k of reaching the goal by the k-th action, of the best
        way from each state, allowed or not; optimal (S, A), the first actions of best ways.
    """
    n_states, chance = len(allowed), not transitions.deterministic
    goal_place, nowhere = n_states, n_states + 1  # after the states in ``worth``
    leads_to = np.where(allowed[transitions.successor], transitions.successor, nowhere)
    leads_to[goal] = goal_place
    leads_to = np.ascontiguousarray(leads_to.transpose(2, 1, 0), dtype=np.intp)  # (B, A, S): quick
    probability = np.ascontiguousarray(transitions.probability.transpose(2, 1, 0))
    worth = np.zeros(n_states + 2)
    worth[goal_place] = 1.0
    value = worth[:n_states]
    each, best = np.empty(leads_to.shape), np.empty(n_states)
    ahead = np.empty(each.shape[1:]) if chance else each[0]
    while True:
        worth.take(leads_to, out=each, mode='clip')  # 'raise' would copy
        if chance:
            np.multiply(each, probability, out=each)
            each.sum(axis=0, out=ahead)
        ahead *= gamma
        ahead.max(axis=0, out=best)
        if np.abs(best - value).max() <= np.finfo(np.float64).eps:
            return best, (ahead >= best - TIE).T
        value[:] = best


ROUNDING = 1e-9  # how far the probabilities of one action may be from 1 in sum


def outcome_limits(transitions: Transitions) -> Floats:
    """
    Return (S, A, B): the probability of each outcome or one before it.

    The last outcome that can happen has 1 exactly, so rounding never leads to an unused one.
    """
    limits = np.cumsum(transitions.probability, axis=2)
    limits[limits > 1 - ROUNDING] = 1.0
    return limits


def draw_outcomes(limits: Floats, state: Any, action: Any, number: Any) -> Ints:
    """
    Return which of the B outcomes uniform numbers choose.

    :param limits: from ``outcome_limits``.
    :param state: index or indices (N,), as ``action``.
    :param number: in [0, 1), one or (N,).
    """
    chosen: Ints = (limits[state, action] <= np.asarray(number)[..., None]).sum(-1)
    return chosen


class TabularSimulator:
    """Takes steps in many games at once, by exact transitions."""

    def __init__(self, transitions: Transitions, over: Flags) -> None:
        """
        Prepare to draw outcomes.

        :param over: (S,) states where the domain's own task is over.
        """
        self.transitions, self._over = transitions, over
        self._limits = None if transitions.deterministic else outcome_limits(transitions)
        tables = transitions.successor, transitions.reward, transitions.terminated
        self._tables = [table.ravel() for table in tables]  # one look-up in each is quicker

    @property
    def deterministic(self) -> bool:
        """Whether every action has one outcome, so that nothing is drawn."""
        return self._limits is None

    def draw(self, rng: np.random.Generator, count: int) -> Floats | None:
        """Draw what chooses the outcomes of N steps; None: every action has one outcome."""
        return None if self._limits is None else rng.random(count)

    def step(self, state: Ints, action: Ints, drawn: Floats | None) -> tuple[Ints, Floats, Flags]:
        """
        Return the next states, the rewards, and whether the task is over there, (N,).

        :param drawn: (N,) from ``draw``.
        """
        outcome: Ints | int = 0
        if self._limits is not None:
            outcome = draw_outcomes(self._limits, state, action, drawn)
        _, actions, outcomes = self.transitions.successor.shape
        place = (state * actions + action) * outcomes + outcome
        successor, reward, terminated = (table.take(place) for table in self._tables)
        there = successor.astype(np.intp)
        return there, reward, terminated | self._over.take(there)
