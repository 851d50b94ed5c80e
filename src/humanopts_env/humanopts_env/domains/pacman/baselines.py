"""
A way to play Pac-Man without learning, to compare plans with under the same rules.

A short hand-written rule over the reference options. An option that was chosen runs to its end, or
is chosen again at every step.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from humanopts_env.domains.pacman.batch import Flags, Ints, PacManBatch
from humanopts_env.domains.pacman.reference import (
    AVOID_GHOST,
    CLOSEST_FOOD,
    EAT_GHOST,
    NEAREST_PILL,
    PacManOption,
)
from humanopts_env.domains.pacman.surroundings import look_around, Surroundings
from humanopts_env.seeding import generator
import numpy as np

TOO_NEAR = 3  # steps to a dangerous ghost at which the hand-written rule takes to flight


@dataclass(frozen=True, slots=True)
class Scores:
    """How N games ended."""

    score: Ints  # (N,) points
    cleared: Flags  # (N,)
    lives: Ints  # (N,) left
    steps: Ints  # (N,)


# From games, what is around, which options can start (O, N) and chance, the options' indices (N,).
Chooser = Callable[[PacManBatch, Surroundings, Flags, np.random.Generator], Ints]


def hand_rule(options: Sequence[PacManOption]) -> Chooser:
    """
    Return the hand-written rule over the four buttons of table 1, in any order, among others.

    Eat a scared ghost that can be caught in time, unless a dangerous one is beside; else, where a
    dangerous ghost is too near, go to a power pill that is nearer, or avoid the ghost; else go to
    the closest food.
    """
    names = [option.name for option in options]
    food, avoid, pill, eat = map(names.index, (CLOSEST_FOOD, AVOID_GHOST, NEAREST_PILL, EAT_GHOST))

    def choose(
        batch: PacManBatch, seen: Surroundings, available: Flags, rng: np.random.Generator
    ) -> Ints:
        threatened = seen.danger <= TOO_NEAR
        return np.select(
            [
                available[eat] & (seen.prey <= seen.fear) & (seen.danger > 2),
                available[pill] & threatened & (seen.pill < TOO_NEAR),
                available[avoid] & threatened,
            ],
            [eat, pill, avoid],
            food,
        )

    return choose


def play_options(
    options: Sequence[PacManOption],
    choose: Chooser,
    games: int,
    max_steps: int,
    seed: int,
    *,
    to_end: bool = True,
) -> Scores:
    """
    Play with options; among equally good moves, the first.

    :param to_end: an option runs to its end; False: one is chosen at every step.
    """
    rng = generator(seed, 'baseline', 'options')
    running = np.full(games, -1, dtype=np.intp)
    batch, each = PacManBatch(options[0].rules, games), np.arange(games)
    steps = np.zeros(games, dtype=np.intp)
    for _ in range(max_steps):
        if batch.over.all():
            break
        seen = look_around(batch)
        said = [option.judge(batch, seen) for option in options]
        ended = np.stack([judgement.termination for judgement in said])[running, each]
        chosen = choose(batch, seen, np.stack([j.initiation for j in said]), rng)
        running = np.where(ended | (running < 0) | (not to_end), chosen, running)
        moves: Ints = np.stack([j.optimal for j in said])[running, each].argmax(axis=1)
        steps += ~batch.over
        batch.step(moves, batch.draws(rng))
    return Scores(batch.score, batch.food_left == 0, batch.lives, steps)
