"""Mazes drawn at random: connected, mirrored, without dead ends, and the same by seed."""

from humanopts_env.domains.pacman.domain import PacMan
from humanopts_env.domains.pacman.paths import maze_paths, STAY
from humanopts_env.domains.pacman.random_mazes import random_maze
from humanopts_env.seeding import generator
import numpy as np
import pytest


@pytest.mark.parametrize('number', range(40))
def test_every_maze_is_whole_and_can_be_walked_round(number: int) -> None:
    maze = random_maze(generator(1, 'test', 'maze', number))
    lines = maze.text.splitlines()
    assert (len(maze.homes), len(maze.pills)) == (2, 2)
    assert len(maze.cells) == sum(len(line) - line.count('%') for line in lines), 'all reached'
    assert len(maze.food) == len(maze.cells) - 5, 'ghosts, pills and Pac-Man lie elsewhere'
    mirrored = [line.replace('P', '.') for line in lines]
    assert mirrored == [line[::-1] for line in mirrored]
    paths = maze_paths(maze)
    ways = (paths.step[:, :STAY] != np.arange(len(maze.cells))[:, None]).sum(axis=1)
    assert ways.min() >= 2, 'no dead end'
    assert min(paths.distance[maze.start, home] for home in maze.homes) >= 2


def test_mazes_are_those_of_the_seed_and_differ() -> None:
    texts = [random_maze(generator(2, 'test', 'maze', n)).text for n in range(20)]
    assert texts == [random_maze(generator(2, 'test', 'maze', n)).text for n in range(20)]
    assert len(set(texts)) == 20
    assert {len(text.splitlines()) for text in texts} == {9, 11, 13}


def test_a_maze_is_played_to_the_end_by_random_moves() -> None:
    rng = generator(3, 'test', 'play')
    games = PacMan(maze=random_maze(rng).text).batch_games()
    batch = games.batch_reset(20, rng)
    for _ in range(2000):
        games.batch_step(batch, rng.integers(STAY, size=20), rng)
    assert games.batch_over(batch).all()
    assert batch.score.min() > 0
