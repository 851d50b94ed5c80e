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
from hypothesis import given, settings, strategies
import numpy as np
import pytest

FOUR_GHOSTS = str(Path(__file__).with_name('four_ghosts.lay'))
NO_GHOST = '%%%%%\n%P..%\n%%%%%'
MAZES = ('gardens', 'yard', FOUR_GHOSTS, NO_GHOST)


@pytest.mark.heavy
@settings(max_examples=15)
@given(
    maze=strategies.sampled_from(MAZES),
    ghosts=strategies.sampled_from(['random', 'chase']),
    lives=strategies.integers(1, 3),
    seed=strategies.integers(0, 10**6),
    hunger=strategies.sampled_from([0.0, 0.7, 0.95]),
)
def test_games_agree_with_the_single_form_step_by_step(
    maze: str, ghosts: str, lives: int, seed: int, hunger: float
) -> None:
    """States, points, ends and features of long games, played at random or mostly for food."""
    domain, rng = PacMan(maze, ghosts, lives), generator(seed, 'agree')
    rules = domain.rules
    batch, read = PacManBatch.begin(rules, 8), FeatureReader(rules)
    towards_food = read.names.index('food_direction')
    states = [rules.start()] * 8
    for step in range(150):
        moves = rng.integers(4, size=8)
        wanted = read(batch)[:, towards_food].astype(int)
        moves = np.where((rng.random(8) < hunger) & (wanted < 4), wanted, moves)
        draws = batch.draws(rng)
        points = batch.step(moves, draws)
        after = [
            state if rules.is_over(state) else rules.advance(state, int(move), drawn)
            for state, move, drawn in zip(states, moves, draws.T.tolist())
        ]
        assert batch.states() == after
        assert points.tolist() == [new.score - old.score for old, new in zip(states, after)]
        assert batch.over.tolist() == [rules.is_over(state) for state in after]
        row = step % 8
        assert np.array_equal(read(batch)[row], domain.feature_values(after[row]))
        states = after


def test_agreement_is_tested_on_everything_that_can_happen() -> None:
    """Such games lose lives, clear the maze, and eat pills, fruit and ghosts."""
    batch = PacManBatch.begin(PacMan().rules, 30)
    read, rng = FeatureReader(batch.rules), generator(0, 'everything')
    towards_food, ate = read.names.index('food_direction'), 0
    for _ in range(400):
        batch.step(read(batch)[:, towards_food].astype(int) % 4, batch.draws(rng))
        ate |= int(np.bitwise_or.reduce(batch.ate))
    assert ate == 1 | 2 | 4 | 8
    assert (batch.food_left == 0).any()
    assert (batch.lives == 0).any()


@pytest.mark.parametrize('maze', MAZES)
def test_states_go_into_a_batch_and_come_out(maze: str) -> None:
    domain = PacMan(maze)
    states = domain.sample_states(generator(0, 'states'), 40)
    batch = PacManBatch.from_states(domain.rules, states)
    assert batch.states() == states
    assert batch.food_left.tolist() == [state.food.bit_count() for state in states]
    assert PacManBatch.from_states(domain.rules, []).states() == []


def test_games_that_are_over_stay_as_they_are() -> None:
    rules = PacMan('yard', lives=1).rules
    batch, rng = PacManBatch.begin(rules, 50), generator(0, 'over')
    for _ in range(300):
        over, before = batch.over, batch.states()
        points = batch.step(rng.integers(4, size=50), batch.draws(rng))
        assert not points[over].any()
        kept = [old == new for old, new in zip(before, batch.states())]
        assert np.array(kept)[over].all()
    assert batch.over.any()


def test_chosen_games_are_copied_put_and_begun_again() -> None:
    rules, rng = PacMan().rules, generator(0, 'chosen')
    batch = sample_games(rules, rng, 6)
    states = batch.states()
    some = batch.take(np.array([4, 4, 1]))
    assert some.states() == [states[4], states[4], states[1]]
    some.step(np.array([0, 1, 2]), some.draws(rng))
    assert batch.states() == states
    batch.put(np.array([0, 2]), batch.take(np.array([5, 3])))
    batch.restart(np.array([1]))
    assert batch.states() == [states[5], rules.start(), states[3], states[3], states[4], states[5]]


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
