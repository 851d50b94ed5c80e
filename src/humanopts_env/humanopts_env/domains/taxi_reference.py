"""
The Taxi options of the paper as reference options.

Subramanian, Isbell and Thomaz (2011), table 1. Each option follows shortest paths from its
initiation set to its goal, and ends as soon as it has left that set. States in which the task is
over are not in any initiation set.
"""

from collections.abc import Container

from humanopts_env.arrays import Flags
from humanopts_env.domains.base import EnumerableDomain
from humanopts_env.domains.reference import TabularReferenceOption
from humanopts_env.domains.tabular import distance_to, feature_column, reachable, read_only
from humanopts_env.domains.taxi import TaxiState
import numpy as np

Taxi = EnumerableDomain[TaxiState]


def reference_options(
    domain: Taxi, names: Container[str] | None = None
) -> dict[str, TabularReferenceOption]:
    """Return the Taxi options of the paper's table 1 by name, or only those in ``names``."""
    transitions = domain.transitions()
    successor = transitions.successor[:, :, 0]
    reward, delivers = transitions.reward[:, :, 0], transitions.terminated[:, :, 0]
    aboard, at_passenger, at_destination = (
        feature_column(domain, name) == 1
        for name in ('passenger_in_taxi', 'taxi_at_passenger', 'taxi_at_destination')
    )
    blocked = feature_column(domain, 'blocked_moves') != 0
    taxi = ('taxi_row', 'taxi_col')
    passenger = ('passenger_row', 'passenger_col')
    destination = ('destination_row', 'destination_col')
    visited, over = reachable(domain), domain.over()
    found = {}

    def add(
        name: str,
        definition: str,
        features: tuple[str, ...],
        initiation: Flags,
        goal: Flags,
        ends_episode: bool = False,
    ) -> None:
        """
        Add an option with the shortest paths to its goal within its initiation set.

        :param initiation: (S,) initiation set; states that are over or unreachable are removed.
        :param goal: (S, A), the transitions that reach its goal.
        :param ends_episode: whether one of these transitions can end the episode.
        """
        if names is not None and name not in names:
            return
        initiation = initiation & visited & ~over
        distance, optimal = distance_to(transitions, goal, initiation)
        found[name] = TabularReferenceOption(
            domain=domain,
            name=name,
            features=features,
            initiation=read_only(initiation),
            termination=read_only(~initiation),
            optimal=read_only(optimal),
            distance=read_only(distance),
            judged=read_only(visited & (~over | ends_episode)),
            definition=definition,
        )

    add(
        'go to passenger and pickup',
        'Starts where the passenger waits; drives there and picks up; ends with the '
        'passenger aboard.',
        (*taxi, *passenger, 'passenger_in_taxi'),
        ~aboard,
        aboard[successor],
    )
    add(
        'go to destination and dropoff',
        'Starts with the passenger aboard; drives to the destination and drops off; ends '
        'with the passenger delivered.',
        (*taxi, *destination, 'passenger_in_taxi'),
        aboard,
        delivers,
        ends_episode=True,
    )
    add(
        'go to passenger',
        'Starts where the passenger waits in another cell; drives there; ends with the taxi '
        'where the passenger is.',
        (*taxi, *passenger, 'taxi_at_passenger'),
        ~at_passenger,
        at_passenger[successor],
    )
    add(
        'go to destination',
        'Starts away from the destination, whether or not the passenger is aboard; drives '
        'there; ends with the taxi at the destination.',
        (*taxi, *destination, 'taxi_at_destination'),
        ~at_destination,
        at_destination[successor],
    )
    add(
        'pickup/dropoff',
        'Starts with the taxi where the passenger waits, or at the destination with the '
        'passenger aboard; picks up or drops off; ends after that one action.',
        ('passenger_in_taxi', 'taxi_at_passenger', 'taxi_at_destination'),
        np.where(aboard, at_destination, at_passenger),
        reward > -1,  # a legal pickup or a delivery
        ends_episode=True,
    )
    add(
        'move away from obstacles',
        'Starts where a wall or the edge blocks a move; drives to the nearest cell that is '
        'open on all four sides; ends there.',
        (*taxi, 'blocked_moves'),
        blocked,
        ~blocked[successor],
    )
    return found
