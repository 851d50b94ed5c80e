"""The rules of a courier in a street, who must not run out of power, in plain Python."""

import random

CHARGER, BASE = -8, 0  # cells, from west to east
NEAREST, FARTHEST = 2, 6  # cells of targets
FULL, STEP = 100.0, 1.5  # charge of a full battery, and charge used per step, %
SLIP = 0.1  # probability that a move fails
MAX_STEPS, GAMMA = 200, 0.995  # of an episode
ACTIONS = {
    'west': ('left', 'drive west'),
    'east': ('right', 'drive east'),
    'drop': ('d', 'drop the parcel'),
    'plug': ('p', 'take a full battery'),
}  # key and description
WAYS = ('west', 'east', 'here')
ERRANDS = ('none', 'delivered', 'charged')
FEATURES = {
    'base_way': ('which way the base is', WAYS),
    'target_way': ('which way the target of the parcel is', WAYS),
    'charger_way': ('which way the charger is', WAYS),
    'errand': ('what it has done since it began to leave the base', ERRANDS),
    'battery': ('how full the battery is', ()),  # %
}  # question and values


class Street:
    """
    A street: parcels are carried from a base to the east, and batteries are changed in the west.

    A delivery earns 1. On return to the base, the courier gets a parcel for a new target. An empty
    battery ends the episode.
    """

    def reset(self, seed: int) -> None:
        """Start an episode at the base, with a random charge."""
        self.chance = random.Random(seed)
        self.cell, self.errand, self.steps = BASE, 'none', 0
        self.target = self.chance.randint(NEAREST, FARTHEST)
        self.battery = self.chance.uniform(0.4, 1.0) * FULL

    def step(self, action: str) -> float:
        """Take an action, and return its reward."""
        before, reward = self.cell, 0.0
        self.steps += 1
        self.battery = max(self.battery - STEP, 0.0)
        if action in ('west', 'east'):
            self.errand = 'none' if self.cell == BASE else self.errand
            move = (1 if action == 'east' else -1) * (self.chance.random() >= SLIP)
            self.cell = min(max(self.cell + move, CHARGER), FARTHEST)
        elif action == 'drop' and self.cell == self.target and self.errand == 'none':
            self.errand, reward = 'delivered', 1.0
        elif action == 'plug' and self.cell == CHARGER:
            self.errand, self.battery = 'charged', FULL
        if self.cell == BASE != before:
            self.target = self.chance.randint(NEAREST, FARTHEST)
        return reward

    @property
    def empty(self) -> bool:
        """Whether the battery is empty, which ends the task."""
        return self.battery <= 0

    @property
    def cut_off(self) -> bool:
        """Whether the episode is at its step limit."""
        return self.steps >= MAX_STEPS and not self.empty

    def features(self) -> list[float]:
        """Return the value of each feature: an index into its values, or the charge."""
        places = BASE, self.target, CHARGER
        ways = [float((p > self.cell) + 2 * (p == self.cell)) for p in places]
        return [*ways, float(ERRANDS.index(self.errand)), self.battery]
