"""Random tasks: from a start to a goal."""

from humanopts_env.domains.search_space import SearchSpace
from humanopts_learner.automatic.reaching import Errands
from humanopts_learner.planning.errors import PlanError
from humanopts_learner.qlearning import Flags, Ints
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components


def draw_tasks(space: SearchSpace, count: int, rng: np.random.Generator) -> Errands:
    """
    Draw tasks (Stolle and Precup 2002, step 1).

    The goal of a task is another state that the start can be reached from and that can be reached
    from it; or the domain's own, where episodes begin with random goals. A task also ends, in
    vain, where the domain's own is over.

    :raises PlanError: no two states can be reached from each other, so there are no goals.
    """
    if space.goals is not None:
        start = rng.choice(space.starts, count)
        target = np.broadcast_to(space.goals, (count, len(space.goals)))
    else:
        start, target = _pairs(space, count, rng)
    return Errands(start, np.ones(count, dtype=np.intp), target, np.zeros_like(target))


def _pairs(space: SearchSpace, count: int, rng: np.random.Generator) -> tuple[Ints, Flags]:
    region = _regions(space)
    sizes = np.bincount(region[space.starts])
    starts = space.starts[sizes[region[space.starts]] > 1]
    if not starts.size:
        raise PlanError('no two states can be reached from each other, so no tasks can be set')
    start = rng.choice(starts, count)
    target = np.zeros((count, len(region)), dtype=np.bool_)
    for task, state in enumerate(start):
        there = starts[region[starts] == region[state]]
        target[task, rng.choice(there[there != state])] = True
    return start, target


def _regions(space: SearchSpace) -> Ints:
    """Return (S,): numbers of the sets of states that can be reached from each other."""
    rules, count = space.transitions, len(space.over)
    possible = (rules.probability > 0) & ~space.over[:, None, None]
    here, there = np.nonzero(possible)[0], rules.successor[possible]
    edges = coo_array((np.ones(len(here)), (here, there)), shape=(count, count))
    region: Ints = connected_components(edges.tocsr(), connection='strong')[1].astype(np.intp)
    return region
