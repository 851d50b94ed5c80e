"""Reachability and shortest paths over the exact transitions of enumerable domains."""

from typing import Any, TypeVar

from humanopts_env.domains.base import EnumerableDomain, Transitions
import numpy as np
from numpy.typing import NDArray

Scalar = TypeVar('Scalar', bound=np.generic)


def read_only(array: NDArray[Scalar]) -> NDArray[Scalar]:
    """Return the same array, made read-only so that it can be shared."""
    array.setflags(write=False)
    return array


def reachable(domain: EnumerableDomain[Any]) -> NDArray[np.bool_]:
    """
    Return (S,): which states an episode can come to from the start states.

    Nothing is reached through a state where the task is over.
    """
    transitions, over = domain.transitions(), domain.over()
    found = np.zeros(domain.n_states, dtype=np.bool_)
    frontier = domain.start_states()
    while frontier.size:
        found[frontier] = True
        going = frontier[~over[frontier]]
        fresh = np.zeros_like(found)
        fresh[transitions.successor[going][transitions.probability[going] > 0]] = True
        frontier = np.flatnonzero(fresh & ~found).astype(np.int32)
    return found


def distance_to(
    transitions: Transitions, goal: NDArray[np.bool_], allowed: NDArray[np.bool_]
) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """
    Find the shortest ways to a goal by breadth-first search backwards from it.

    :param transitions: of a deterministic domain.
    :param goal: (S, A), the transitions that reach the goal, taken from allowed states only.
    :param allowed: (S,), the states that a path may visit before its last action.
    :return: distance (S,), the fewest actions including the one that reaches the goal, -1 where
        the state is not allowed or has no way; optimal (S, A), the actions of shortest ways.
    :raises ValueError: the transitions are not deterministic.
    """
    if not transitions.deterministic:
        raise ValueError('shortest ways need transitions with one outcome for each action')
    successor = transitions.successor[:, :, 0]
    optimal = goal & allowed[:, None]
    distance = np.where(optimal.any(axis=1), 1, -1).astype(np.int32)
    waiting = np.flatnonzero(allowed & (distance < 0))
    for steps in range(2, len(distance) + 2):
        nearer = distance[successor[waiting]] == steps - 1
        found = nearer.any(axis=1)
        if not found.any():
            break
        distance[waiting[found]] = steps
        optimal[waiting[found]] = nearer[found]
        waiting = waiting[~found]
    return distance, optimal
