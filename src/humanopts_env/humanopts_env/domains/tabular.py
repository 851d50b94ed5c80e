"""Exact tables of domains: reachability, shortest paths, steps in many games."""

from typing import Any, TypeVar

from humanopts_env.arrays import Flags, Floats, Ints
from humanopts_env.domains.base import EnumerableDomain, Transitions
from humanopts_env.domains.formulas import feature_columns
import numpy as np
from numpy.typing import NDArray

Scalar = TypeVar('Scalar', bound=np.generic)
TIE = 1e-12  # smaller differences between action values are ties


def read_only(array: NDArray[Scalar]) -> NDArray[Scalar]:
    """Return the same array, made read-only so that it can be shared."""
    array.setflags(write=False)
    return array


def feature_column(domain: EnumerableDomain, name: str) -> Floats:
    """Return the value of one feature in every state, (S,)."""
    return feature_columns(domain, [name])[0].values(domain.feature_table())


def reachable(domain: EnumerableDomain) -> Flags:
    """
    Return (S,): whether an episode can reach each state from the start states.

    Paths do not continue from states where the task is over.
    """
    transitions, over = domain.transitions(), domain.over()
    found = np.zeros(domain.n_states, dtype=np.bool_)
    frontier = domain.start_states()
    while frontier.size:
        found[frontier] = True
        going = frontier[~over[frontier]]
        successor = transitions.successor[going][transitions.probability[going] > 0]
        frontier = np.unique(successor[~found[successor]])
    return found


def distance_to(
    transitions: Transitions, goal: Flags, allowed: Flags
) -> tuple[NDArray[np.int32], Flags]:
    """
    Find the shortest paths to a goal by backward breadth-first search.

    :param transitions: transitions of a deterministic domain.
    :param goal: (S, A), the transitions that reach the goal, taken from allowed states only.
    :param allowed: (S,), the states that a path may visit before its last action.
    :return: distance (S,), the fewest actions including the one that reaches the goal, -1 if the
        state is not allowed or has no path; optimal (S, A), the actions of shortest paths.
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


def best_paths(
    transitions: Transitions, goal: Flags, allowed: Flags, gamma: float
) -> tuple[Floats, Flags]:
    """
    Find the best paths to a goal, with or without chance, by value iteration to convergence.

    :param goal: (S, A, B), the outcomes that reach the goal.
    :param allowed: (S,), the states that a path may visit between its first and its last step.
    :param gamma: discount, below 1; in deterministic domains, the best paths are the shortest.
    :return: value (S,), the expected gamma**k of reaching the goal with the k-th action of the
        best path from each state, allowed or not; optimal (S, A), the first actions of best paths.
    """
    n_states, chance = len(allowed), not transitions.deterministic
    goal_place, nowhere = n_states, n_states + 1  # after the states in ``worth``
    leads_to = np.where(allowed[transitions.successor], transitions.successor, nowhere)
    leads_to[goal] = goal_place
    leads_to = np.ascontiguousarray(leads_to.transpose(2, 1, 0), dtype=np.intp)  # (B, A, S): fast
    probability = np.ascontiguousarray(transitions.probability.transpose(2, 1, 0))
    worth = np.zeros(n_states + 2)
    worth[goal_place] = 1.0
    value = worth[:n_states]
    each, best = np.empty(leads_to.shape), np.empty(n_states)
    ahead = np.empty(each.shape[1:]) if chance else each[0]
    while True:
        worth.take(leads_to, out=each, mode='clip')  # mode 'raise' would copy
        if chance:
            np.multiply(each, probability, out=each)
            each.sum(axis=0, out=ahead)
        ahead *= gamma
        ahead.max(axis=0, out=best)
        if np.abs(best - value).max() <= np.finfo(np.float64).eps:
            return best, (ahead >= best - TIE).T
        value[:] = best


ROUNDING = 1e-9  # tolerance for the sum of an action's probabilities


def outcome_limits(transitions: Transitions) -> Floats:
    """
    Return the cumulative probabilities of the outcomes, (S, A, B).

    The last possible outcome has exactly 1, so rounding never selects an unused one.
    """
    limits = np.cumsum(transitions.probability, axis=2)
    limits[limits > 1 - ROUNDING] = 1.0
    return limits


def draw_outcomes(limits: Floats, state: Any, action: Any, number: Any) -> Ints:
    """
    Return the indices of the outcomes, 0..B-1, selected by uniform numbers.

    :param limits: result of ``outcome_limits``.
    :param state: index or indices (N,) of states, as in ``action``.
    :param number: uniform number or numbers (N,) in [0, 1).
    """
    chosen: Ints = (limits[state, action] <= np.asarray(number)[..., None]).sum(-1)
    return chosen


class TabularSimulator:
    """Takes steps in many games at once with exact transitions."""

    def __init__(self, transitions: Transitions, over: Flags) -> None:
        """
        Prepare to draw outcomes.

        :param over: (S,) states where the domain's own task is over.
        """
        self.transitions, self._over = transitions, over
        self._limits = None if transitions.deterministic else outcome_limits(transitions)
        tables = transitions.successor, transitions.reward, transitions.terminated
        self._tables = [table.ravel() for table in tables]  # flat: a single look-up is faster

    @property
    def deterministic(self) -> bool:
        """Whether every action has one outcome, so that no random draws are needed."""
        return self._limits is None

    def draw(self, rng: np.random.Generator, count: int) -> Floats | None:
        """Draw uniform numbers for the outcomes of N steps; None if deterministic."""
        return None if self._limits is None else rng.random(count)

    def step(self, state: Ints, action: Ints, drawn: Floats | None) -> tuple[Ints, Floats, Flags]:
        """
        Return the next states, the rewards, and whether the task is over, (N,) each.

        :param drawn: (N,) result of ``draw``.
        """
        outcome: Ints | int = 0
        if self._limits is not None:
            outcome = draw_outcomes(self._limits, state, action, drawn)
        _, actions, outcomes = self.transitions.successor.shape
        place = (state * actions + action) * outcomes + outcome
        successor, reward, terminated = (table.take(place) for table in self._tables)
        successor = successor.astype(np.intp)
        return successor, reward, terminated | self._over.take(successor)
