"""How many game steps a second the batched forms take, beside the single form."""

from functools import partial
from typing import Any

from humanopts_env.domains.base import Domain, is_enumerable
from humanopts_env.domains.pacman.domain import PacMan
from humanopts_env.domains.tabular_games import TabularGames
from humanopts_env.domains.taxi import Taxi
from humanopts_env.seeding import generator
from humanopts_learner.planning.request import batch_games
import numpy as np

from benchmarks.measure import clocks, compare, in_turns, OnMeasured, Row, Times

QUICK = (2, 50, 2)
BATCH = 4096  # games
RULES_TARGET, FEATURES_TARGET = 1e6, 2e5  # steps of Pac-Man a second, on one core
SEED = 1


def measure(
    progress: OnMeasured, batch_steps: int = 40, single_steps: int = 2000, repeats: int = 7
) -> list[Row]:
    """
    Step games at random, many at once and one by one; games that are over begin again.

    :param batch_steps: steps of all games that one sample takes.
    :param single_steps: steps of one game that one sample of the yardstick takes.
    :param repeats: turns of each form.
    """
    forms: list[tuple[str, Domain[Any], bool, float | None]] = [
        ('Pac-Man: rules', PacMan(), False, RULES_TARGET),
        ('Pac-Man: rules and every feature', PacMan(), True, FEATURES_TARGET),
        ('Taxi: rules', Taxi(), False, None),
        ('Taxi: rules and every feature', Taxi(), True, None),
    ]
    rows = []
    for number, (what, domain, features, target) in enumerate(forms):
        progress(number / len(forms), what)
        many = partial(_many, domain, batch_steps, features=features)
        single = partial(_one, domain, single_steps, features=features)
        ours, one = in_turns([many, single], repeats)
        facts = {'games': BATCH, 'steps': BATCH * batch_steps, 'yardstick_steps': single_steps}
        usual = 'the same, one game at a time'
        rows.append(compare(what, ours, usual, one, target=target, facts=facts))
    return rows


def _many(domain: Domain[Any], steps: int, *, features: bool) -> Times:
    """Return the time of one step of one game among many."""
    games = TabularGames(domain) if is_enumerable(domain) else batch_games(domain)
    rng = generator(SEED, 'benchmark', 'games')
    moves = rng.integers(len(domain.actions), size=(steps, BATCH))
    batch = games.batch_reset(BATCH, rng)
    began = clocks()
    for move in moves:
        games.batch_step(batch, move, rng)
        if features:
            games.batch_features(batch)
        over = np.flatnonzero(games.batch_over(batch))
        games.batch_put(batch, over, games.batch_reset(len(over), rng))
    return (clocks() - began) / (steps * BATCH)


def _one(domain: Domain[Any], steps: int, *, features: bool) -> Times:
    """Return the time of one step of the only game."""
    rng = generator(SEED, 'benchmark', 'game')
    actions = rng.integers(len(domain.actions), size=steps).tolist()
    state = domain.reset(rng)
    began = clocks()
    for action in actions:
        outcome = domain.step(state, action, rng)
        if features:
            domain.feature_values(outcome.state)
        state = domain.reset(rng) if outcome.terminated else outcome.state
    return (clocks() - began) / steps
