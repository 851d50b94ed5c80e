"""The reference options of the greenhouse, by shortest paths."""

from humanopts_env.domains.base import EnumerableDomain
from humanopts_env.domains.reference import TabularReferenceOption
from humanopts_env.domains.tabular import distance_to, reachable
import numpy as np
from numpy.typing import NDArray

from humanopts_greenhouse.greenhouse import BEDS, GreenhouseState

Domain = EnumerableDomain[GreenhouseState]


def reference_options(domain: Domain) -> dict[str, TabularReferenceOption]:
    """Return the options by name."""
    table = domain.feature_table()
    full, dry = table[:, 2] == 1, table[:, 3:].sum(axis=1)
    after = domain.transitions().successor[:, :, 0]
    options = [
        _option(
            domain,
            'fill the can',
            'Starts with the can empty; walks to the tap and fills; ends with the can full.',
            ('row', 'col', 'can_full'),
            ~full,
            full[after],
        ),
        _option(
            domain,
            'water the nearest dry bed',
            'Starts with the can full; walks to the nearest dry bed and pours; ends with the can '
            'empty.',
            ('row', 'col', 'can_full', *[f'{bed}_dry' for bed in BEDS]),
            full,
            dry[after] < dry[:, None],
        ),
    ]
    return {option.name: option for option in options}


def _option(
    domain: Domain,
    name: str,
    definition: str,
    features: tuple[str, ...],
    starts: NDArray[np.bool_],
    goal: NDArray[np.bool_],
) -> TabularReferenceOption:
    """
    Return an option that follows shortest paths, and ends wherever it cannot start.

    :param starts: (S,) whether the option can start in each state if the task is not over.
    :param goal: (S, A) whether each step reaches the goal.
    """
    visited = reachable(domain)
    initiation = starts & visited & ~domain.over()
    distance, optimal = distance_to(domain.transitions(), goal, initiation)
    return TabularReferenceOption(
        domain=domain,
        name=name,
        features=features,
        initiation=initiation,
        termination=~initiation,
        optimal=optimal,
        distance=distance,
        judged=visited & (~domain.over() | ~starts),
        definition=definition,
    )
