"""
The search space of subgoals: the states of the random tasks, and the counting of visits.

S states, K cells, M situations. In every domain, visits are counted by the agent's cell. A step
that changes a status (Taxi: whether the passenger is aboard) is an event. Initiation sets consist
of situations: states that differ only in constants of the episode (Taxi: the destination) belong
to one situation.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from humanopts_env.arrays import Flags, Ints, Rows
from humanopts_env.domains.base import BoardSlice, EnumerableDomain, Transitions
from humanopts_env.domains.formulas import feature_columns, stacked
from humanopts_env.domains.tabular import reachable
import numpy as np


@dataclass(frozen=True, eq=False)
class SearchSpace:
    """The states of the random tasks, with the cell, status and situation of each."""

    transitions: Transitions
    over: Flags  # (S,) whether the domain's own task is over
    reached: Flags  # (S,) whether an episode can reach the state
    goals: Flags | None  # (S,) goals of the domain's own task; None: random goals
    cell: Ints  # (S,) 0..K-1
    cell_names: tuple[str, ...]
    status: Ints  # (S,) a change of the status is an event
    events: tuple[str, ...]  # name of the event that leads to each status; empty: no events
    situation: Ints  # (S,) 0..M-1
    rows: Rows  # (S, F) the domain's features; only ``columns`` are meaningful
    columns: tuple[int, ...]  # indices of the features available to the options
    board: BoardSlice | None = None  # states laid out for a figure

    @cached_property
    def open(self) -> Flags:
        """(S,): whether an episode can reach the state and is not over there."""
        return self.reached & ~self.over

    @cached_property
    def starts(self) -> Ints:
        """The start states of tasks."""
        return np.flatnonzero(self.open)


def space_of_states(domain: EnumerableDomain) -> SearchSpace:
    """Return the search space with random goals and every state as a separate cell."""
    return plain_space(
        domain.transitions(),
        domain.over(),
        reachable(domain),
        domain.feature_table(),
        tuple(range(len(domain.features))),
        [domain.encode(domain.state_at(state)) for state in range(domain.n_states)],
        next(iter(domain.board_slices()), None),
    )


def plain_space(
    transitions: Transitions,
    over: Flags,
    reached: Flags,
    rows: Rows,
    columns: Sequence[int],
    cell_names: Sequence[str],
    board: BoardSlice | None,
) -> SearchSpace:
    """Return a search space without events, with random goals and every state as a cell."""
    states = np.arange(len(over))
    return SearchSpace(
        transitions=transitions,
        over=over,
        reached=reached,
        goals=None,
        cell=states,
        cell_names=tuple(cell_names),
        status=np.zeros_like(states),
        events=(),
        situation=states,
        rows=rows,
        columns=tuple(columns),
        board=board,
    )


def space_by_features(
    domain: EnumerableDomain,
    *,
    cell: Sequence[str],
    status: str,
    events: Mapping[str, str],
    situation: Sequence[str],
    own_goals: bool,
    cell_name: Callable[[tuple[int, ...]], str] | None = None,
) -> SearchSpace:
    """
    Return the search space defined by features of a domain.

    :param cell: features of the agent's position.
    :param status: feature; each change of its value is an event.
    :param events: names of the events, by the text of the new value of ``status``.
    :param situation: all features that an action can change.
    :param own_goals: True: the goals of the domain's own task (states reached by a final step
        with the highest reward), suitable if they are random or if few steps can be undone;
        False: random goals.
    :param cell_name: function from the feature values of a cell to its name; None: names such as
        ``cell 2,3``.
    :raises DomainError: the domain has no such feature.
    """
    transitions = domain.transitions()
    cells, numbers = _groups(domain, cell)
    column = feature_columns(domain, [status])[0]
    name = cell_name or plain_cell_name
    return SearchSpace(
        transitions=transitions,
        over=domain.over(),
        reached=reachable(domain),
        goals=_best_ends(transitions) if own_goals else None,
        cell=numbers,
        cell_names=tuple(name(tuple(values)) for values in cells.tolist()),
        status=column.values(domain.feature_table()).astype(np.intp),
        events=tuple(events[value] for value in column.feature.values),
        situation=_groups(domain, situation)[1],
        rows=domain.feature_table(),
        columns=tuple(range(len(domain.features))),
        board=next(iter(domain.board_slices()), None),
    )


def plain_cell_name(values: tuple[int, ...]) -> str:
    """Return the default name of a cell, such as ``cell 2,3``."""
    return f'cell {",".join(map(str, values))}'


def _groups(domain: EnumerableDomain, names: Sequence[str]) -> tuple[Ints, Ints]:
    """Return the distinct value combinations of features, and their index by state, (S,)."""
    rows = stacked(feature_columns(domain, names), domain.feature_table())
    values, group = np.unique(rows, axis=0, return_inverse=True)
    return values.astype(np.intp), group.ravel()


def _best_ends(transitions: Transitions) -> Flags:
    """Return (S,): whether a final step with the highest reward leads to the state."""
    ending = transitions.terminated & (transitions.probability > 0)
    best = ending & (transitions.reward == transitions.reward[ending].max())
    goals = np.zeros(len(transitions.successor), dtype=np.bool_)
    goals[transitions.successor[best]] = True
    return goals
