"""
Bottlenecks of greedy runs, and the initiation sets of the options that lead to them.

M. Stolle and D. Precup (2002), "Learning Options in Reinforcement Learning", step 3: the most
visited state is the target of an option. Its initiation set consists of states from which the
target is reached and that have more visits than average on paths through the target, completed to
a contiguous region. Then the visits of all paths through the target are subtracted, and the step
is repeated.

Our changes: the visited states are cells. A cell in which runs have events (``status`` changes)
gives one option for each kind of event, instead of one for reaching the cell. Initiation sets
count only visits between the previous event and the target, since the path after the target does
not lead to it. Situations with more than half of their neighbours in the region are added to it,
and states from which the target cannot be reached within the region are removed.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

from humanopts_env.arrays import Flags, Ints
from humanopts_env.domains.search_space import SearchSpace
import numpy as np
from scipy.sparse import coo_array


@dataclass(frozen=True)
class Bottleneck:
    """The target and the initiation set of an option."""

    name: str
    cell: int
    event: str  # such as pickup or dropoff; empty: reaching the cell
    visits: int  # visits to the cell when it was selected
    target: Flags  # (S,)
    initiation: Flags  # (S,)


@dataclass(frozen=True)
class Visits:
    """The visits of greedy runs, ordered by run and step."""

    space: SearchSpace
    run: Ints  # (V,)
    state: Ints  # (V,)

    @cached_property
    def counts(self) -> Ints:
        """(runs, K): visits of each run to each cell."""
        counts = np.zeros((int(self.run.max(initial=-1)) + 1, len(self.space.cell_names)), np.intp)
        np.add.at(counts, (self.run, self.space.cell[self.state]), 1)
        return counts

    @cached_property
    def happens(self) -> Flags:
        """(V,): whether the step to this visit was an event."""
        status = self.space.status[self.state]
        changed: Flags = (np.diff(status, prepend=-1) != 0) & ~self.begins
        return changed

    @property
    def begins(self) -> Flags:
        """(V,): whether this visit is the first of its run."""
        first: Flags = np.diff(self.run, prepend=-1) != 0
        return first

    def before(self, arrivals: Ints) -> Ints:
        """
        Return the states (N,) visited between the previous event and each arrival.

        :param arrivals: (H,) indices of visits.
        """
        stretch = np.cumsum(self.begins | self.happens) - 1
        limit = np.zeros(len(self.state), dtype=np.intp)
        since = np.where(self.happens[arrivals], arrivals - 1, arrivals)
        np.maximum.at(limit, stretch[since], arrivals)
        on_path = np.arange(len(self.state)) < limit[stretch]
        found: Ints = self.state[on_path]
        return found


def find_bottlenecks(visits: Visits, most: int) -> list[Bottleneck]:
    """Return at most ``most`` bottlenecks, in the order found."""
    found: list[Bottleneck] = []
    counts = visits.counts
    left = counts.any(axis=1)
    while len(found) < most and left.any():
        total = counts[left].sum(axis=0)
        cell = int(total.argmax())
        found += _options_to(visits, cell, int(total[cell]))
        left &= counts[:, cell] == 0
    return found[:most]


def _options_to(visits: Visits, cell: int, total: int) -> Iterator[Bottleneck]:
    space = visits.space
    name, inside = space.cell_names[cell], space.cell == cell
    here = inside[visits.state]
    happened = here & visits.happens
    after = space.status[visits.state]
    kinds = np.unique(after[happened]).tolist()
    for status in kinds:
        event, target = space.events[status], inside & (space.status == status)
        arrivals = np.flatnonzero(happened & (after == status))
        start = _initiation(visits, arrivals, target)
        yield Bottleneck(f'{event} at {name}', cell, event, total, target, start)
    if not kinds:
        start = _initiation(visits, np.flatnonzero(here & ~visits.begins), inside)
        yield Bottleneck(f'go to {name}', cell, '', total, inside, start)


def _initiation(visits: Visits, arrivals: Ints, target: Flags) -> Flags:
    """Return (S,): the initiation set of an option that leads to a target."""
    space, situations = visits.space, visits.space.situation
    count = int(situations.max()) + 1
    counts = np.bincount(situations[visits.before(arrivals)], minlength=count)
    chosen = counts > counts[np.unique(situations[space.reached])].mean()
    here, there = (situations[states] for states in _edges(space, space.open))
    apart = here != there
    ends = here[apart], there[apart]
    steps = coo_array((np.ones(len(ends[0])), ends), shape=(count, count)).tocsr()
    neighbours = steps + steps.T  # situations connected by a step in either direction
    neighbours.data[:] = 1.0
    half, before = neighbours.sum(axis=1) / 2, np.zeros_like(chosen)
    while (chosen != before).any():  # add situations with more than half of their neighbours
        before = chosen
        chosen = chosen | (neighbours @ chosen.astype(np.float64) > half)
    region: Flags = chosen[situations] & space.open & ~target
    here, there = _edges(space, region)
    found = target.copy()  # states from which the target can be reached within the region
    while (fresh := here[found[there] & ~found[here]]).size:
        found[fresh] = True
    return found & region


def _edges(space: SearchSpace, inside: Flags) -> tuple[Ints, Ints]:
    """Return the start and end state (N,) each of all possible steps from selected states."""
    possible = (space.transitions.probability > 0) & inside[:, None, None]
    return np.nonzero(possible)[0], space.transitions.successor[possible].astype(np.intp)
