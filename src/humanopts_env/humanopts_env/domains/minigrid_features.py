"""
Features of MiniGrid: the agent, its neighbourhood, and each kind of object in the environment.

The whole grid is read, not only the part that the agent sees. Names and ranges are the same for
all seeds of an environment, and for environments of other sizes with the same kinds of objects.

Features that transfer to other places come first; people are asked about features in this order.

Of several objects of a kind, the features describe the one with the colour that the mission names,
else a locked door, else the nearest object. If the mission names several colours of one kind, each
colour has its own features, such as red_door_path. If missions name objects of different kinds,
the named object has features as the target.
"""

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
import copy
from functools import lru_cache, partial
import re
from typing import Any, NamedTuple

from humanopts_env.domains.base import Feature, FeatureKind

SIZE = 25  # cells, side of MiniGrid's largest grids; ranges grow only for larger ones
SCANNED = 16  # number of seeds with grids that are searched for kinds of objects
COLOURS = 'red', 'green', 'blue', 'purple', 'yellow', 'grey'
PORTABLE = 'key', 'ball', 'box'
THINGS = (*PORTABLE, 'door', 'goal', 'lava')  # in the order of their features
TARGET = 'target'
NAMED = re.compile(rf'({"|".join(COLOURS)}) ({"|".join((*PORTABLE, "door"))})')
CONTENTS = 'empty', 'wall', *PORTABLE, 'open door', 'closed door', 'locked door', 'goal', 'lava'
DIRECTIONS = 'east', 'south', 'west', 'north'  # in the order of MiniGrid
MOVES = 'left', 'right', 'forward', 'there', 'none'
LEFT, RIGHT, FORWARD, THERE, NOWHERE = range(5)
DOOR_STATES = 'open', 'closed', 'locked', 'none'
ACTIONS = {
    'left': 'turn left',
    'right': 'turn right',
    'forward': 'walk one cell',
    'pickup': 'pick up the object in front',
    'drop': 'put the carried object down in front',
    'toggle': 'open, close or unlock what is in front',
    'declare_done': 'declare that the mission is done; only some missions need it',
}
Cell = tuple[int, int]  # column, row, as in MiniGrid


class Thing(NamedTuple):
    """A kind of object with its own features."""

    name: str  # prefix of the features, such as red_door
    kind: str  # kind in MiniGrid, or target
    colour: str = ''  # empty: any


def features(env: Any) -> Mapping[str, Any]:
    """Return the features of a MiniGrid environment."""
    width, cells = env.grid.width, env.grid.grid
    col, row = map(int, env.agent_pos)
    facing = int(env.agent_dir)
    walkable, objects = bytearray(len(cells)), []
    for cell, each in enumerate(cells):
        if each is None:
            walkable[cell] = 1
        elif (kind := each.type) != 'wall':
            walkable[cell] = kind == 'floor' or (kind == 'door' and not each.is_locked)
            objects.append((cell, each))
    pose, grid = 4 * (row * width + col) + facing, bytes(walkable)
    values: dict[str, Any] = {'carrying': env.carrying.type if env.carrying else 'nothing'}
    for name, turn in (('front', 0), ('left', 3), ('right', 1)):
        right, down = STEPS[(facing + turn) % 4]
        x, y = col + right, row + down
        inside = 0 <= x < width and 0 <= y < env.grid.height
        values[name] = contents(cells[y * width + x]) if inside else 'wall'
    named = NAMED.findall(env.mission)
    for thing in things_of(env):
        name, kind = thing.name, thing.kind
        found = _objects_of(thing, named, objects)
        ways = [
            (len(grid), NOWHERE) if kind == 'lava' else way(grid, width, cell, pose)
            for cell, _ in found
        ]
        there = None
        if found:
            offsets = [(cell % width - col, cell // width - row) for cell, _ in found]
            sizes = [abs(right) + abs(down) for right, down in offsets]
            best = min(range(len(found)), key=lambda n: (ways[n][0], sizes[n], n))
            there = found[best][1]
            right, down = offsets[best]
            ahead = (right, down, -right, -down)[facing]
            aside = (down, -right, -down, right)[facing]
        if kind != 'lava':
            move = NOWHERE if there is None else ways[best][1]
            if there is not None and not sizes[best]:
                move = THERE
            elif move == THERE and kind == 'goal':
                move = FORWARD
            values[f'{name}_path'] = MOVES[move]
        if kind in PORTABLE:
            values[f'{name}_present'] = there is not None
        if kind == 'door':
            values[f'{name}_state'] = contents(there).removesuffix(' door') if there else 'none'
        values[f'{name}_distance'] = None if there is None else sizes[best]
        values[f'{name}_ahead'] = None if there is None else ahead
        values[f'{name}_right'] = None if there is None else aside
    return values | {'direction': DIRECTIONS[facing], 'row': row, 'col': col}


class View(dict[str, Any]):
    """The agent's observation, computed when it is read."""

    def __init__(self, compute: Callable[[], Mapping[str, Any]]) -> None:
        """Store the function that computes the observation."""
        super().__init__()
        self._compute = compute

    def __missing__(self, key: str) -> Any:
        self.update(self._compute())
        return self[key]


def PREPARE(env: Any) -> None:  # noqa: N802 - the name that extractors use
    """Compute observations only when read: they take four fifths of the time."""
    env.gen_obs = partial(View, env.gen_obs)


def RANGES(env: Any) -> dict[str, Feature]:  # noqa: N802 - the name that extractors use
    """Return the features of an environment with their ranges and questions."""
    size = max(SIZE, env.width, env.height)
    found = [
        *Feature.place('', 'the agent', size, size),
        Feature.nominal('direction', 'which way the agent faces', DIRECTIONS),
        Feature.nominal('carrying', 'what the agent carries', ('nothing', *PORTABLE)),
        Feature.nominal('front', 'what is in front of the agent', CONTENTS),
        Feature.nominal('left', 'what is on the left of the agent', CONTENTS),
        Feature.nominal('right', 'what is on the right of the agent', CONTENTS),
    ]
    sides = tuple(map(str, range(1 - size, size)))
    for name, kind, _ in things_of(env):
        words = f'the {name.replace("_", " ")}'
        if kind in PORTABLE:
            question = f'whether {words} is on the grid'
            found.append(Feature.nominal(f'{name}_present', question, ('no', 'yes')))
        if kind == 'door':
            question = f'whether {words} is open, closed or locked'
            found.append(Feature.nominal(f'{name}_state', question, DOOR_STATES))
        for side, question in (
            ('ahead', f'how far ahead of the agent {words} is'),
            ('right', f'how far to the right of the agent {words} is'),
        ):
            values = (*sides, 'none')
            found.append(Feature(f'{name}_{side}', question, FeatureKind.ORDINAL, values))
        question = f'how many cells away {words} is'
        found.append(Feature.number(f'{name}_distance', question, 2 * size - 1, 'none'))
        if kind != 'lava':
            question = f'which move is the first of a shortest path to {words}'
            found.append(Feature.nominal(f'{name}_path', question, MOVES))
    return {feature.name: feature for feature in found}


def contents(thing: Any) -> str:
    """Return the contents of a cell, one of ``CONTENTS``."""
    if thing is None or thing.type == 'floor':
        return 'empty'
    if thing.type == 'door':
        return f'{"open" if thing.is_open else "locked" if thing.is_locked else "closed"} door'
    return str(thing.type)


def _objects_of(
    thing: Thing, named: Sequence[tuple[str, str]], objects: Sequence[tuple[int, Any]]
) -> list[tuple[int, Any]]:
    """Return the candidates for a thing, with their cells; features describe the nearest."""
    if thing.kind == TARGET:
        wanted = named[:1]
        return [(cell, each) for cell, each in objects if (each.color, each.type) in wanted]
    found = [(cell, each) for cell, each in objects if each.type == thing.kind]
    if thing.colour:
        return [(cell, each) for cell, each in found if each.color == thing.colour]
    if len(found) > 1:
        found = [pair for pair in found if (pair[1].color, thing.kind) in named] or found
    if thing.kind == 'door':
        found = [pair for pair in found if pair[1].is_locked] or found
    return found


_things: dict[tuple[Any, ...], list[Thing]] = {}


def things_of(env: Any) -> list[Thing]:
    """Return the things with features in an environment, the same for all of its seeds."""
    spec = env.spec
    key = (type(env), env.width, env.height, *((spec.id, repr(spec.kwargs)) if spec else ()))
    if key not in _things:
        _things[key] = list(_scanned(copy.deepcopy(env)))
    return _things[key]


def _scanned(env: Any) -> Iterator[Thing]:
    """Yield the things on the grids of some seeds."""
    kinds, missions = set(), []
    for seed in range(SCANNED):
        env.reset(seed=seed)
        kinds |= {each.type for each in env.grid.grid if each is not None}
        missions.append(NAMED.findall(env.mission))
    for kind in filter(kinds.__contains__, THINGS):
        colours = [{colour for colour, of in mission if of == kind} for mission in missions]
        if len(colours[0]) > 1 and all(each == colours[0] for each in colours):
            yield from (Thing(f'{colour}_{kind}', kind, colour) for colour in sorted(colours[0]))
        else:
            yield Thing(kind, kind)
    if all(missions) and len({mission[0][1] for mission in missions}) > 1:
        yield Thing(TARGET, TARGET)


# Shortest paths.

STEPS: tuple[Cell, ...] = ((1, 0), (0, 1), (-1, 0), (0, -1))  # column and row, by direction


def way(walkable: bytes, width: int, target: int, pose: int) -> tuple[int, int]:
    """
    Return the number of moves until the agent faces a cell, and the first of them.

    :param walkable: (cells,) 1 where the agent can walk; closed doors can be opened on the way.
    :param target: index of the cell to face.
    :param pose: 4 times the index of the agent's cell, plus its direction.
    :return: number of moves, and LEFT, RIGHT, FORWARD or THERE; without a path, 4 times the number
        of cells, and NOWHERE.
    """
    moves = moves_to(walkable, width, target)
    here = moves[pose]
    if here <= 0:
        return (0, THERE) if here == 0 else (len(moves), NOWHERE)
    cell, facing = divmod(pose, 4)
    right, down = STEPS[facing]
    front = 4 * (cell + right + width * down) + facing
    if 0 <= front < len(moves) and moves[front] == here - 1:
        return here, FORWARD
    return here, LEFT if moves[4 * cell + (facing - 1) % 4] == here - 1 else RIGHT


@lru_cache(maxsize=10_000)
def moves_to(walkable: bytes, width: int, target: int) -> list[int]:
    """Return the number of moves from each pose until the target is in front; -1 if none."""
    ahead = [right + width * down for right, down in STEPS]
    moves = [-1] * (4 * len(walkable))
    waiting: deque[int] = deque()
    for facing, step in enumerate(ahead):
        cell = target - step
        if 0 <= cell < len(walkable) and walkable[cell]:
            moves[4 * cell + facing] = 0
            waiting.append(4 * cell + facing)
    while waiting:
        pose = waiting.popleft()
        cell, facing = divmod(pose, 4)
        before = [4 * cell + (facing + 1) % 4, 4 * cell + (facing - 1) % 4]
        behind = cell - ahead[facing]
        if 0 <= behind < len(walkable) and walkable[behind]:
            before.append(4 * behind + facing)
        for each in before:
            if moves[each] < 0:
                moves[each] = moves[pose] + 1
                waiting.append(each)
    return moves
