"""Orchard: a windy field where apples are picked and carried to a barn, at most two at a time."""

from humanopts_env import Action, Feature, ReplayedDomain
import numpy as np

SIZE, APPLES, BASKET, SLIP = 8, 6, 2, 0.1
MOVES = {'north': (-1, 0), 'south': (1, 0), 'west': (0, -1), 'east': (0, 1)}
KEYS = ('up', 'down', 'left', 'right')
WAYS = (*MOVES, 'none')


class Field:
    """The mutable world: the positions of the picker and the apples."""

    def reset(self, seed: int) -> None:
        """Scatter the apples; the barn is in the north-west corner."""
        self.rng = np.random.default_rng(seed)
        cells = self.rng.choice(SIZE * SIZE - 1, APPLES + 1, replace=False) + 1
        self.picker, *self.apples = [divmod(int(cell), SIZE) for cell in cells]
        self.basket = 0

    def step(self, action: int) -> tuple[float, bool]:
        """Walk; the wind may change the direction. Picking and unloading happen on arrival."""
        if self.rng.random() < SLIP:
            action = int(self.rng.integers(len(MOVES)))
        down, right = list(MOVES.values())[action]
        row, col = self.picker[0] + down, self.picker[1] + right
        self.picker = min(max(row, 0), SIZE - 1), min(max(col, 0), SIZE - 1)
        if self.picker in self.apples and self.basket < BASKET:
            self.apples.remove(self.picker)
            self.basket += 1
        delivered = self.basket if self.picker == (0, 0) else 0
        self.basket -= delivered
        return 10.0 * delivered - 1.0, not self.apples and not self.basket

    def features(self) -> list[float]:
        """Return the directions of the nearest apple and the barn, and the load of the basket."""
        nearest = min(self.apples, key=self.distance, default=self.picker)
        return [self.way(nearest), self.way((0, 0)), self.basket]

    def distance(self, cell: tuple[int, int]) -> int:
        return abs(cell[0] - self.picker[0]) + abs(cell[1] - self.picker[1])

    def way(self, cell: tuple[int, int]) -> int:
        """Return the index of the first move of a shortest path: north or south first."""
        down, right = cell[0] - self.picker[0], cell[1] - self.picker[1]
        return ((down > 0) if down else 2 + (right > 0)) if down or right else WAYS.index('none')


class Orchard(ReplayedDomain):
    """Carry all apples to the barn; a step costs 1, an apple in the barn earns 10."""

    name, gamma, max_steps = 'orchard', 0.97, 300
    parameters: dict[str, int] = {}
    features = (
        Feature.nominal('apple_direction', 'which way the nearest apple is', WAYS),
        Feature.nominal('barn_direction', 'which way the barn is', WAYS),
        Feature.number('basket', 'how many apples are in the basket', BASKET + 1),
    )
    actions = tuple(Action(name, key, f'go {name}') for name, key in zip(MOVES, KEYS))

    def make_world(self) -> Field:
        return Field()
