"""Many games at once are the same games as one by one, and quick."""

from collections.abc import Callable
from pathlib import Path
from statistics import median
from time import process_time

from humanopts_env.domains.pacman.domain import PacMan
from humanopts_env.domains.pacman.features import FeatureReader
from humanopts_env.domains.pacman.games import sample_games
from humanopts_env.domains.pacman.rules import DRAWS, PacManBatch, Rules
from humanopts_env.seeding import generator
import numpy as np
import pytest

FOUR_GHOSTS = str(Path(__file__).with_name('four_ghosts.lay'))
NO_GHOST = '%%%%%\n%P..%\n%%%%%'
MAZES = ('gardens', 'yard', FOUR_GHOSTS, NO_GHOST)


@pytest.mark.parametrize('maze', MAZES)
def test_states_go_into_a_batch_and_come_out(maze: str) -> None:
    domain = PacMan(maze)
    states = domain.sample_states(generator(0, 'states'), 40)
    batch = PacManBatch.from_states(domain.rules, states)
    assert batch.states() == states
    assert batch.food_left.tolist() == [state.food.bit_count() for state in states]
    assert PacManBatch.from_states(domain.rules, []).states() == []


def test_draws_are_all_alike_and_depend_on_the_generator_alone() -> None:
    batch = PacManBatch.begin(PacMan().rules, 30_000)
    draws = batch.draws(generator(3, 'draws'))
    assert draws.shape == (2, 30_000)
    counts = np.bincount(draws.ravel(), minlength=DRAWS)
    assert len(counts) == DRAWS
    assert abs(counts - 1000).max() < 160  # five standard deviations
    assert np.array_equal(draws, batch.draws(generator(3, 'draws')))


def test_sampled_games_come_from_all_parts_of_the_game() -> None:
    """None is over; food, pills, fear, fruit and lives are there in all amounts."""
    batch = sample_games(PacMan().rules, generator(0, 'sample'), 2000)
    assert not batch.over.any()
    left = batch.food_left / 98
    for low in (0.0, 0.25, 0.5, 0.75):
        assert ((left > low) & (left <= low + 0.25)).mean() > 0.05
    assert (batch.scared > 0).any(axis=0).mean() > 0.1
    assert (batch.fruit > 0).mean() > 0.1
    assert set(batch.lives.tolist()) == {1, 2, 3}
    assert len(sample_games(batch.rules, generator(0, 'none'), 0)) == 0


def rate(call: Callable[[], object], games: int) -> float:
    """Return games a second, the median of some runs on this core."""
    call()
    seconds = []
    for _ in range(15):
        start = process_time()
        call()
        seconds.append(process_time() - start)
    return games / median(seconds)


@pytest.mark.slow
@pytest.mark.parametrize('ghosts', ['random', 'chase'])
def test_a_million_steps_a_second_and_200_000_with_all_features(ghosts: str) -> None:
    """On one core, many games at once, with the drawing of chance and restarts."""
    rules: Rules = PacMan(ghosts=ghosts).rules
    games, rng = 4096, generator(0, 'speed')
    batch, read = sample_games(rules, rng, games), FeatureReader(rules)

    def play(steps: int = 20) -> None:
        for _ in range(steps):
            batch.step(rng.integers(4, size=games), batch.draws(rng))
            batch.restart(np.flatnonzero(batch.over))

    def watch() -> None:
        for _ in range(20):
            play(1)
            read(batch)

    assert rate(play, 20 * games) > 1_000_000
    assert rate(watch, 20 * games) > 200_000
