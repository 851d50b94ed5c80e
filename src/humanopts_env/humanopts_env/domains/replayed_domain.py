"""
Mutable worlds as domains: a state is a seed and the actions since the reset.

A state is restored by replay: the world is reset with the seed and repeats the actions. Thus even
a world that cannot be copied can be simulated, set to any previous state, and played in parallel.
"""

from abc import ABC, abstractmethod
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
import re
import string
import time
from typing import Any, Protocol, runtime_checkable

from humanopts_env.arrays import Flags, Floats, Ints, Rows
from humanopts_env.board import Image
from humanopts_env.domains.base import Domain, DomainError, Outcome, StateError
from humanopts_env.games import Chance, Steps
from humanopts_env.seeding import generator
import numpy as np
from numpy.typing import NDArray

SIGNS = string.digits + string.ascii_letters  # one character per action in a text
SIGN_OF = SIGNS.encode().ljust(256)  # tables of ``bytes.translate``, for speed
ACTION_OF = bytes.maketrans(SIGNS.encode(), bytes(range(len(SIGNS))))
MAX_WORLDS = 256  # worlds kept at the same time, beside those of parallel games
MAX_WALK, GAP = 200, 10  # actions before a sampled state; states of a walk per sample
SEEDS = 10**9
REPLAYED, ENOUGH = 20, 0.1  # maximum steps and seconds of a repeated episode
MAX_SECONDS, SLACK = 0.5, 2.0  # s per step, since a replay takes many; s added to the limit
STATE = re.compile(r'seed (0|[1-9][0-9]{0,19}) actions (-|[0-9a-zA-Z]+)')


class World(Protocol):
    """A mutable world; the seed of its reset determines all random draws."""

    def reset(self, seed: int) -> None:
        """Start an episode that does not depend on the previous one."""

    def step(self, action: int) -> tuple[float, bool]:
        """Take one primitive action; return the reward and whether the task is over."""

    def features(self) -> Sequence[float]:
        """Return the current value of every feature; see ``Feature``."""


@runtime_checkable
class DrawnWorld(World, Protocol):
    """A world that can be drawn without opening a window or changing the world."""

    def picture(self) -> Any:
        """Return an image, (H, W, 3) uint8, a text drawing, or None."""


@dataclass(frozen=True, slots=True)
class History:
    """A state of a world: the past actions and the resulting observation."""

    seed: int
    actions: tuple[int, ...]
    features: tuple[float, ...]
    over: bool = False


class ReplayedDomain(Domain[History], ABC):
    """
    The domain of a mutable world.

    A subclass sets the attributes of ``Domain`` and implements ``make_world``. The seed and the
    actions of a state determine the future, so only ``reset`` draws random numbers, not ``step``.

    Recent worlds are kept, so that continuing from their states takes one step; other states are
    replayed. Parallel games step their worlds without keeping a state for each step.
    """

    @abstractmethod
    def make_world(self) -> World:
        """Return a new world; each is used for many episodes."""

    def reset(self, rng: np.random.Generator) -> History:
        return self._begin(int(rng.integers(SEEDS)))

    def step(self, state: History, action: int, rng: np.random.Generator) -> Outcome[History]:
        if not 0 <= action < len(self.actions):
            raise DomainError(
                f'{self.name} has no action {action}; it has 0 to {len(self.actions) - 1}'
            )
        if state.over:
            raise DomainError(f'the task is over in {self.encode(state)!r}: no step can be taken')
        return self._take(state.seed, state.actions, action)

    def is_over(self, state: History) -> bool:
        return state.over

    def can_follow(self, state: History, action: int, successor: History) -> bool:
        """Return whether the successor's actions are those of the state plus this one."""
        done = state.seed, (*state.actions, action)
        return not state.over and (successor.seed, successor.actions) == done

    def feature_values(self, state: History) -> Floats:
        return np.array(state.features, dtype=np.float64)

    def encode(self, state: History) -> str:
        """Return the state as one line, such as ``seed 7 actions 0012``."""
        signs = bytes(state.actions).translate(SIGN_OF).decode()
        return f'seed {state.seed} actions {signs or "-"}'

    def decode(self, text: str) -> History:
        match = STATE.fullmatch(text)
        actions = tuple(match[2].strip('-').encode().translate(ACTION_OF)) if match else ()
        if match is None or max(actions, default=0) >= len(self.actions):
            raise StateError(
                f'{text!r} is not a state of {self.name}; write one like "seed 7 actions 0012"'
            )
        seed = int(match[1])
        if kept := self._worlds.get((seed, actions)):
            return kept[1]
        return self._take(seed, actions[:-1], actions[-1]).state if actions else self._begin(seed)

    def world(self, state: History) -> World:
        """Return a world in a state, for reading only: it must not be stepped or reset."""
        key = state.seed, state.actions
        if key not in self._worlds:
            self.decode(self.encode(state))  # replays the state
        return self._worlds[key][0]

    def picture(self, state: History) -> Image | str | None:
        """
        Return the picture that the world draws of a state; None if it draws none.

        :raises DomainError: the picture is neither a text nor an image.
        """
        world = self.world(state)
        drawn = world.picture() if isinstance(world, DrawnWorld) else None
        if drawn is None or isinstance(drawn, str):
            return drawn
        image = np.array(drawn)
        if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or not image.size:
            raise DomainError(f'{self.name} draws {image.dtype} {image.shape}, not an RGB image')
        return image

    def sample_states(self, rng: np.random.Generator, count: int) -> list[History]:
        """Draw states that are not over from random walks, about one in GAP of each walk."""
        found: list[History] = []
        while len(found) < count:
            seed = int(rng.integers(SEEDS))
            world = self._begun(seed)
            length = rng.integers(min(self.max_steps or MAX_WALK, MAX_WALK))
            actions = tuple(rng.integers(len(self.actions), size=length).tolist())
            looks = {*rng.choice(length + 1, 1 + length // GAP, replace=False).tolist()}
            for step in range(length + 1):
                if step in looks:
                    found.append(_history(world, seed, actions[:step]))
                if step == length or world.step(actions[step])[1]:
                    break
            self._spare.append(world)
        return [found[place] for place in rng.permutation(len(found))[:count]]

    def games(self, states: Sequence[History]) -> 'ReplayedGames':
        """Return games in given states."""
        return ReplayedGames(self, states)

    def check_replay(self) -> None:
        """
        Check that seed and actions determine an episode: repeat it later, and in another world.

        :raises DomainError: the repeated episodes differ, or steps are slow.
        """
        names = ['the reward', 'the end', *(feature.name for feature in self.features)]
        actions = generator(0, 'replay').integers(len(self.actions), size=REPLAYED).tolist()
        world, episodes = self.make_world(), list[list[list[float]]]()
        for played, seed in ((world, 0), (world, 1), (world, 0), (self.make_world(), 0)):
            began = time.perf_counter()
            played.reset(seed)
            rows = [[0.0, 0.0, *played.features()]]
            for action in actions:
                reward, over = played.step(action)
                rows.append([reward, over, *played.features()])
                check_pace(self.name, began, len(rows) - 1)
                if over or time.perf_counter() - began > ENOUGH:
                    break
            episodes += [rows] if seed == 0 else []
        for again in episodes[1:]:
            for step, (first, second) in enumerate(zip(episodes[0], again)):
                for what, one, two in zip(names, first, second):
                    if one != two:
                        raise DomainError(
                            f'{self.name} is not determined by its seed: after {step} '
                            f'identical actions, {what} was {one} once and {two} later; draw '
                            'all random numbers from the seed, in Gymnasium by self.np_random'
                        )

    @cached_property
    def _worlds(self) -> OrderedDict[tuple[int, tuple[int, ...]], tuple[World, History]]:
        """Worlds and their states by seed and actions, the newest last."""
        return OrderedDict()

    @cached_property
    def _spare(self) -> list[World]:
        """Worlds for new episodes, since creating one may be slow."""
        return []

    def _begun(self, seed: int) -> World:
        try:
            world = self._spare.pop()
        except IndexError:
            world = self.make_world()
        world.reset(seed)
        return world

    def _begin(self, seed: int) -> History:
        return self._keep(self._world_at(seed, ()), seed, (), over=False)

    def _take(self, seed: int, actions: tuple[int, ...], action: int) -> Outcome[History]:
        """
        Take an action after previous actions.

        :raises StateError: the task is already over.
        """
        world = self._world_at(seed, actions)
        reward, over = world.step(action)
        after = self._keep(world, seed, (*actions, action), over=bool(over))
        return Outcome(after, float(reward), after.over)

    def _world_at(self, seed: int, actions: tuple[int, ...]) -> World:
        """Remove and return the kept world in this state, or replay the actions."""
        kept = self._worlds.pop((seed, actions), None)
        if kept is not None and not kept[1].over:
            return kept[0]
        world = self._begun(seed)
        for action in actions:
            _, over = world.step(action)
            if over:
                raise StateError(f'the task of {self.name} with seed {seed} is over before that')
        return world

    def _keep(self, world: World, seed: int, actions: tuple[int, ...], *, over: bool) -> History:
        """Keep a world and return its state."""
        state = _history(world, seed, actions, over=over)
        self._worlds[seed, actions] = world, state
        if len(self._worlds) > MAX_WORLDS:
            _, (oldest, _) = self._worlds.popitem(last=False)
            self._spare.append(oldest)
        return state


class ReplayedGames:
    """Games in mutable worlds; the world of a game is restored when its next step is taken."""

    def __init__(self, domain: ReplayedDomain, states: Sequence[History]) -> None:
        """Start in given states."""
        self.domain = domain
        self._worlds: list[World | None] = [None] * len(states)
        self._seeds = [state.seed for state in states]
        self._actions = [list(state.actions) for state in states]
        self._rows = [state.features for state in states]
        self._over = np.array([state.over for state in states], dtype=np.bool_)

    def __len__(self) -> int:
        return len(self._seeds)

    def features(self) -> Rows:
        shape = len(self), len(self.domain.features)
        return np.array(self._rows, dtype=np.float64).reshape(shape)

    def over(self) -> Flags:
        return self._over.copy()

    def step(self, actions: Ints, chance: Chance) -> Steps:
        reward, taken = np.zeros(len(self)), actions.tolist()
        for game in np.flatnonzero(~self._over).tolist():
            world = self._worlds[game]
            if world is None:
                world = self.domain._world_at(self._seeds[game], tuple(self._actions[game]))
                self._worlds[game] = world
            reward[game], over = world.step(taken[game])
            self._actions[game].append(taken[game])
            self._rows[game] = tuple(map(float, world.features()))
            if over:
                self._over[game] = True
                self._release(game)
        return Steps(reward, self.over())

    def reset(self, games: Ints, chance: np.random.Generator) -> None:
        for game in games.tolist():
            self._release(game)
            self._seeds[game] = seed = int(chance.integers(SEEDS))
            self._worlds[game] = world = self.domain._begun(seed)
            self._actions[game], self._over[game] = [], False
            self._rows[game] = tuple(map(float, world.features()))

    def take(self, games: Ints) -> 'ReplayedGames':
        states = self.states()
        taken = ReplayedGames(self.domain, [states[game] for game in games.tolist()])
        for place, game in enumerate(games.tolist()):  # the copy takes over the world
            taken._worlds[place], self._worlds[game] = self._worlds[game], None
        return taken

    def states(self) -> list[History]:
        return [
            History(seed, tuple(actions), row, over)
            for seed, actions, row, over in zip(
                self._seeds, self._actions, self._rows, self._over.tolist()
            )
        ]

    def outcomes(self) -> Mapping[str, NDArray[Any]]:
        return {}

    def _release(self, game: int) -> None:
        """Release a game's world, so that other games can use it."""
        world, self._worlds[game] = self._worlds[game], None
        if world is not None:
            self.domain._spare.append(world)


def _history(world: World, seed: int, actions: tuple[int, ...], *, over: bool = False) -> History:
    return History(seed, actions, tuple(map(float, world.features())), over)


def check_pace(name: str, began: float, steps: int) -> None:
    """
    Check the time of some steps; the first may take longer.

    :raises DomainError: the steps are slow.
    """
    seconds = time.perf_counter() - began
    if seconds > SLACK + MAX_SECONDS * steps:
        raise DomainError(
            f'{name} took {seconds:.1f} s for {steps} steps, and a state is restored by repeating '
            f'all of its steps: make them faster than {MAX_SECONDS} s'
        )
