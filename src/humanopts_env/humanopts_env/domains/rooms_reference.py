"""
The eight hallway options of Rooms as reference options.

Sutton, Precup and Singh (1999), section 3: from anywhere in a room, or from its other doorway, an
option walks to one of the room's two doorways, and ends as soon as it has left the room.
"""

from humanopts_env.arrays import Flags
from humanopts_env.domains.base import EnumerableDomain, Transitions
from humanopts_env.domains.reference import TabularReferenceOption
from humanopts_env.domains.rooms import NOWHERE, ROOM_VALUES, ROOMS, RoomsState
from humanopts_env.domains.tabular import best_paths, distance_to, feature_column, read_only
import numpy as np

FEATURES = ('row', 'col', 'room', 'doorway')
Domain = EnumerableDomain[RoomsState]
Mask = Flags


def reference_options(domain: Domain) -> dict[str, TabularReferenceOption]:
    """
    Return the hallway options by name: two per room, independent of the goal.

    The optimal actions have the highest expected gamma**k for reaching the target doorway in k
    steps, with value 0 for all other exits of the room: shortest paths that avoid slipping into
    the other doorway.
    """
    options = [_build(domain, room, doorway) for room, doorway in _pairs(domain)]
    return {option.name: option for option in options}


def _pairs(domain: Domain) -> list[tuple[str, str]]:
    """Return room and doorway of each option."""
    room, doorway = (feature_column(domain, name).astype(np.intp) for name in ('room', 'doorway'))
    successor = domain.transitions().successor
    pairs = []
    for number, name in enumerate(ROOMS.values()):
        around = np.unique(doorway[successor[room == number]])
        pairs += [(name, NOWHERE[side]) for side in around if side]
    return pairs


def _build(domain: Domain, room: str, doorway: str) -> TabularReferenceOption:
    inside = feature_column(domain, 'room') == ROOM_VALUES.index(room)
    target = feature_column(domain, 'doorway') == NOWHERE.index(doorway)
    table, over = domain.transitions(), domain.over()
    around = np.zeros_like(inside)
    around[table.successor[inside]] = True
    walks = inside | (around & ~inside & ~target)  # the room and its other doorway
    _, optimal = best_paths(table, target[table.successor], inside, domain.gamma)
    initiation = walks & ~over
    straight = _without_slips(table)
    distance, _ = distance_to(straight, target[straight.successor[:, :, 0]], walks)
    return TabularReferenceOption(
        domain=domain,
        name=f'{room} room to {doorway} doorway',
        features=FEATURES,
        initiation=read_only(initiation),
        termination=read_only(~inside | over),
        optimal=read_only(optimal & initiation[:, None]),
        # for moves that never slip
        distance=read_only(np.where(initiation, distance, -1).astype(np.int32)),
        judged=read_only(~over | around),
        definition=(
            f'Starts in the {room} room or its other doorway; walks to the {doorway} doorway; '
            f'ends wherever it has left the room.'
        ),
    )


def _without_slips(table: Transitions) -> Transitions:
    """Return the transitions without slipping."""
    reward = table.reward[:, :, :1]
    return Transitions(
        table.successor[:, :, :1], np.ones(reward.shape), reward, table.terminated[:, :, :1]
    )
