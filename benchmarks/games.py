"""Times of a game step, in many games in parallel and in a single game."""

from collections.abc import Callable
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.registry import make_domain
from humanopts_env.games import new_games
from humanopts_env.seeding import generator
import numpy as np
import pytest

STEPS = 4096  # per round: one step of each of 4,096 games, or 4,096 steps of one


@pytest.mark.parametrize('domain', ['pacman', 'taxi'])
@pytest.mark.parametrize('features', [False, True], ids=['rules', 'rules and every feature'])
@pytest.mark.parametrize('together', [True, False], ids=['side by side', 'one game'])
def bench_steps(benchmark: Any, domain: str, features: bool, together: bool) -> None:
    """Take random steps; restart games that are over."""
    what = 'rules and every feature' if features else 'rules'
    benchmark.group = f'{STEPS:,} steps of {domain}, {what}'
    benchmark.name = 'side by side' if together else 'one game'
    step = (_side_by_side if together else _one_game)(make_domain(domain), features)
    benchmark.pedantic(step, rounds=50 if together else 3, warmup_rounds=1)


def _side_by_side(domain: Domain, features: bool) -> Callable[[], None]:
    """Return a function that takes one step in each game."""
    rng = generator(1, 'benchmark', 'games')
    games = new_games(domain, STEPS, rng)

    def step() -> None:
        steps = games.step(rng.integers(len(domain.actions), size=STEPS), rng)
        if features:
            games.features()
        games.reset(np.flatnonzero(steps.over), rng)

    return step


def _one_game(domain: Domain, features: bool) -> Callable[[], None]:
    """Return a function that takes all steps in one game."""
    rng = generator(1, 'benchmark', 'game')

    def steps() -> None:
        state = domain.reset(rng)
        for action in rng.integers(len(domain.actions), size=STEPS).tolist():
            outcome = domain.step(state, action, rng)
            if features:
                domain.feature_values(outcome.state)
            state = domain.reset(rng) if outcome.terminated else outcome.state

    return steps
