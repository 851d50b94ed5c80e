"""
Reference options of MiniGrid: get the key, open the locked door, go to the goal, get the object.

They use the whole grid and take the shortest paths of ``minigrid_features``, on which closed doors
are opened. Of equally good moves, forward comes first, then left.
"""

from typing import Any

from humanopts_env.domains.minigrid_features import (
    contents,
    FORWARD,
    LEFT,
    moves_to,
    RIGHT,
    STEPS,
)
from humanopts_env.domains.reference import Rule

PICKUP, DROP, TOGGLE = 3, 4, 5  # actions; the moves have the same numbers as in the features
WALKABLE = 'empty', 'open door', 'closed door'
Aims = tuple[list[int], int]  # cells to face, and the action to take there


def best_moves(env: Any, aims: Aims) -> tuple[int, ...]:
    """Return all first actions of shortest paths to an aim; empty if there is no path."""
    (col, row), facing, width = map(int, env.agent_pos), int(env.agent_dir), env.grid.width
    here = row * width + col
    ahead = here + STEPS[facing][0] + width * STEPS[facing][1]
    pose, grid = 4 * here + facing, walkable(env)
    ways = [way for cell in aims[0] if (way := moves_to(grid, width, cell))[pose] >= 0]
    least = min((way[pose] for way in ways), default=-1)
    if least <= 0:
        return (aims[1],) if ways else ()
    after = {
        TOGGLE if contents(env.grid.grid[ahead]) == 'closed door' else FORWARD: 4 * ahead + facing,
        LEFT: 4 * here + (facing - 1) % 4,
        RIGHT: 4 * here + (facing + 1) % 4,
    }
    return tuple(move for move, to in after.items() if any(way[to] == least - 1 for way in ways))


def walkable(env: Any) -> bytes:
    """Return (cells,): 1 where the agent can walk, possibly after opening a closed door."""
    return bytes(contents(thing) in WALKABLE for thing in env.grid.grid)


def find(env: Any, kind: str) -> list[int]:
    """Return the cells with given contents, one of ``CONTENTS``."""
    return [cell for cell, thing in enumerate(env.grid.grid) if contents(thing) == kind]


def holds(env: Any, kind: str) -> bool:
    """Return whether the agent carries an object of a kind, or nothing if ``kind`` is nothing."""
    return (env.carrying.type if env.carrying else 'nothing') == kind


def to_the_key(env: Any) -> Aims:
    """Pick up the key while a door is locked and nothing is carried."""
    needed = holds(env, 'nothing') and find(env, 'locked door')
    return find(env, 'key') if needed else [], PICKUP


def to_the_object(env: Any) -> Aims:
    """Pick up the object of the mission; first put any other object down, out of the way."""
    width, grid = env.grid.width, walkable(env)
    there = [cell for cell, thing in enumerate(env.grid.grid) if thing is env.obj]
    if holds(env, 'nothing') or not there:
        return there, PICKUP
    col, row = map(int, env.agent_pos)
    pose = 4 * (row * width + col) + int(env.agent_dir)
    return [
        cell
        for cell in find(env, 'empty')
        if cell != pose // 4
        and moves_to(grid[:cell] + b'\0' + grid[cell + 1 :], width, there[0])[pose] >= 0
    ], DROP


GET_KEY = Rule(
    'get the key',
    'Starts with empty hands while a door is locked; walks to the key and picks it up; ends with '
    'the key in hand.',
    ('carrying', 'front', 'key_path', 'door_state'),
    lambda env, _: best_moves(env, to_the_key(env)),
    lambda env, _: holds(env, 'key'),
)
OPEN_DOOR = Rule(
    'open the locked door',
    'Starts with the key in hand; walks to the locked door and opens it; ends with it open.',
    ('carrying', 'front', 'door_state', 'door_path'),
    lambda env, _: best_moves(
        env, (find(env, 'locked door') if holds(env, 'key') else [], TOGGLE)
    ),
    lambda env, _: not find(env, 'locked door'),
)
GO_TO_GOAL = Rule(
    'go to the goal',
    'Starts where there is a path to the goal; walks there, opening closed doors on the way; '
    'ends there.',
    ('front', 'goal_path'),
    lambda env, _: best_moves(env, (find(env, 'goal'), FORWARD)),
    lambda env, _: contents(env.grid.get(*env.agent_pos)) == 'goal',
)
GET_OBJECT = Rule(
    'get the object',
    'Starts where there is a path to the object of the mission; puts down what is carried, walks '
    'to the object and picks it up; ends with it in hand.',
    ('carrying', 'front', 'left', 'right', 'ball_path', 'box_path'),
    lambda env, _: best_moves(env, to_the_object(env)),
    lambda env, _: env.carrying is not None and env.carrying is env.obj,
)
KEY_TO_GOAL = GET_KEY, OPEN_DOOR, GO_TO_GOAL
KEY_TO_OBJECT = GET_KEY, OPEN_DOOR, GET_OBJECT
MISSIONS: dict[str, tuple[Rule, ...]] = {  # by package and class of the environment
    'minigrid.CrossingEnv': (GO_TO_GOAL,),
    'minigrid.DistShiftEnv': (GO_TO_GOAL,),
    'minigrid.DoorKeyEnv': KEY_TO_GOAL,
    'minigrid.EmptyEnv': (GO_TO_GOAL,),
    'minigrid.FourRoomsEnv': (GO_TO_GOAL,),
    'minigrid.KeyCorridorEnv': KEY_TO_OBJECT,
    'minigrid.LavaGapEnv': (GO_TO_GOAL,),
    'minigrid.LockedRoomEnv': KEY_TO_GOAL,
    'minigrid.MultiRoomEnv': (GO_TO_GOAL,),
    'minigrid.UnlockEnv': (GET_KEY, OPEN_DOOR),
    'minigrid.UnlockPickupEnv': KEY_TO_OBJECT,
}
