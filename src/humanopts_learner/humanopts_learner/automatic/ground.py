"""
Where options are looked for: the states that tasks are set in, and what their visits count for.

S states, K cells, M situations. Visits are counted over the agent's own cell, in every domain.
Where a run changes something else than the cell (Taxi: whether the passenger is aboard), that is
an event. Initiation sets are made of situations: states that differ only in what nothing in the
domain can change (Taxi: which landmark is the destination) are one situation.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from humanopts_env.domains.base import (
    Domain,
    EnumerableDomain,
    feature_columns,
    is_enumerable,
    Transitions,
)
from humanopts_env.domains.pacman.domain import PacMan
from humanopts_env.domains.pacman.paths import STAY
from humanopts_env.domains.tabular import reachable
from humanopts_env.domains.taxi_tables import landmark_cells
from humanopts_learner.planning.errors import NotEnumerableError
from humanopts_learner.qlearning.world import Flags, Ints
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Counting:
    """What the features of a domain are for; states of other domains are cells of their own."""

    cell: tuple[str, ...]  # where the agent is
    status: str  # a change of it is an event
    events: Mapping[str, str]  # what an event is called, by the value that the status takes
    situation: tuple[str, ...]
    own_goals: bool  # the domain's own tasks have random goals, so goals are theirs


COUNTINGS = {
    'taxi': Counting(
        cell=('taxi_row', 'taxi_col'),
        status='passenger_in_taxi',
        events={'yes': 'pickup', 'no': 'dropoff'},
        situation=('taxi_row', 'taxi_col', 'passenger_row', 'passenger_col', 'passenger_in_taxi'),
        own_goals=True,
    )
}


@dataclass(frozen=True)
class Ground:
    """The states that tasks are set in."""

    rules: Transitions
    over: Flags  # (S,) the domain's own task is over
    reached: Flags  # (S,) an episode can come there
    starts: Ints  # states in which tasks begin
    done: Flags | None  # (S,) goals of the domain's own task; None: goals are drawn
    cell: Ints  # (S,) 0..K-1
    cell_names: tuple[str, ...]
    status: Ints  # (S,)
    events: tuple[str, ...]  # by the status that they lead to; none: there are no events
    situation: Ints  # (S,) 0..M-1


def ground_of(domain: Domain[Any]) -> Ground:
    """
    Return where options are looked for in a domain: in Pac-Man, the maze without its ghosts.

    :raises NotEnumerableError: the states of the domain cannot all be listed.
    """
    if isinstance(domain, PacMan):
        return _maze_ground(domain)
    if not is_enumerable(domain):
        raise NotEnumerableError(
            f'the states of {domain.name} cannot all be listed, so no tasks can be set in it'
        )
    counting = COUNTINGS.get(domain.name)
    return _counted_ground(domain, counting) if counting else _plain_ground(domain)


def _plain_ground(domain: EnumerableDomain[Any]) -> Ground:
    names = [domain.encode(domain.state_at(state)) for state in range(domain.n_states)]
    return _simple(domain.transitions(), domain.over(), reachable(domain), names)


def _maze_ground(domain: PacMan) -> Ground:
    step = domain.rules.paths.step[:, :STAY, None].astype(np.int32)
    rules = Transitions(
        step, np.ones(step.shape), np.zeros(step.shape), np.zeros(step.shape, dtype=np.bool_)
    )
    none = np.zeros(len(step), dtype=np.bool_)
    return _simple(rules, none, ~none, [f'cell {r},{c}' for r, c in domain.rules.maze.cells])


def _simple(rules: Transitions, over: Flags, reached: Flags, names: list[str]) -> Ground:
    """Return a ground where every state is its own cell, and goals are drawn."""
    states = np.arange(len(over))
    starts = np.flatnonzero(reached & ~over)
    none = np.zeros_like(states)
    return Ground(rules, over, reached, starts, None, states, tuple(names), none, (), states)


def _counted_ground(domain: EnumerableDomain[Any], counting: Counting) -> Ground:
    rules, over, reached = domain.transitions(), domain.over(), reachable(domain)
    cells, cell = _groups(domain, counting.cell)
    column = feature_columns(domain, [counting.status])[0]
    return Ground(
        rules=rules,
        over=over,
        reached=reached,
        starts=np.flatnonzero(reached & ~over),
        done=_done(rules) if counting.own_goals else None,
        cell=cell,
        cell_names=tuple(_cell_name(domain, values) for values in cells.tolist()),
        status=domain.feature_table()[:, column].astype(np.intp),
        events=tuple(counting.events[value] for value in domain.features[column].values),
        situation=_groups(domain, counting.situation)[1],
    )


def _groups(
    domain: EnumerableDomain[Any], names: tuple[str, ...]
) -> tuple[NDArray[np.int32], Ints]:
    """Return the different values of some features, and which of them each state (S,) has."""
    rows = domain.feature_table()[:, feature_columns(domain, names)]
    values, group = np.unique(rows, axis=0, return_inverse=True)
    return values, group.ravel()


def _cell_name(domain: EnumerableDomain[Any], values: list[int]) -> str:
    if domain.name == 'taxi':
        rows, cols = int(domain.parameters['rows']), int(domain.parameters['cols'])
        landmarks = {cell: name for name, cell in landmark_cells(rows, cols).items()}
        if tuple(values) in landmarks:
            return landmarks[values[0], values[1]]
    return f'cell {",".join(map(str, values))}'


def _done(rules: Transitions) -> Flags:
    """Return (S,): what a step that ends the task with the highest reward leads to."""
    ending = rules.terminated & (rules.probability > 0)
    best = ending & (rules.reward == rules.reward[ending].max())
    done = np.zeros(len(rules.successor), dtype=np.bool_)
    done[rules.successor[best]] = True
    return done
