"""Transfer to other mazes: a real trial of small numbers, and what is said of known results."""

import json
from typing import Any

from graph_support.scripted import expert
from humanopts_env.domains.pacman.domain import PacMan
from humanopts_env.domains.pacman.maze import load_maze
from humanopts_env.domains.pacman.paths import maze_paths, STAY
from humanopts_env.games import new_games
from humanopts_env.seeding import generator
from humanopts_learner.options.learn import learn_option
from humanopts_teach.evaluation.games import Baseline, every_baseline
import numpy as np
import pytest

from experiments import transfer
from experiments.people import BagLesson, OwnedOptions, Study
from experiments.random_mazes import random_maze
from experiments.report import Mark

PLAN, RULE = 'human, 5 options, interrupted, 4-fold steps', 'hand-written rule'


def test_there_are_two_mazes_for_each_seed_and_people_take_turns() -> None:
    trials = transfer.trials(Study(participants=3, seeds=4, seed=2))
    mazes = [trial.parameters['maze'] for trial in trials]
    assert len(set(mazes)) == len(mazes) == 8
    assert mazes == [t.parameters['maze'] for t in transfer.trials(Study(1, 4, 2))]
    people = [trial.parameters['teacher']['person']['code'] for trial in trials]
    assert sorted({people.count(code) for code in people}) == [2, 3]


def test_a_users_mazes_stand_in_and_without_options_of_the_game_there_is_nothing() -> None:
    own = load_maze('yard').text
    (trial,) = transfer.trials(Study(mazes=(own,)))
    assert trial.parameters['maze'] == own
    lesson = BagLesson('/bag', 'p1', 'go', 'taxi', '{}', 'failures', 1, 'x')
    assert transfer.trials(Study(bags=(lesson,))) == []


def test_options_play_in_a_maze_that_was_not_taught_in(monkeypatch: pytest.MonkeyPatch) -> None:
    def taught(owner: object, domain: PacMan, names: tuple[str, ...]) -> OwnedOptions:
        return OwnedOptions(
            tuple(learn_option(expert(name, 40, domain), domain, 1) for name in names)
        )

    def some(*game: Any) -> list[Baseline]:
        return [baseline for baseline in every_baseline(*game) if baseline.name in ways]

    ways = [PLAN, 'random choice, 5 options', RULE]
    monkeypatch.setattr(transfer, 'options_of', taught)
    monkeypatch.setattr(transfer, 'every_baseline', some)
    trial, *_ = transfer.trials(Study(participants=1, seeds=1))
    small = {**trial.parameters, 'steps': 800, 'games': 4}
    rows = trial.compute(small)
    assert json.loads(json.dumps(rows)) == rows
    assert [(row['game'], row['way to play']) for row in rows] == [
        (game, way) for game in ('ghosts=random', 'ghosts=chase') for way in ways
    ]
    scores = {(row['game'], row['way to play']): row['score'] for row in rows}
    assert scores['ghosts=random', 'random choice, 5 options'] > 500


def done(*differences: float) -> list[tuple[dict[str, Any], list[dict[str, Any]]]]:
    """Return results in which the plan has so much more than the rule, by maze."""
    mazes = []
    for number, more in enumerate(differences, start=1):
        points = 1000.0 * number  # mazes differ much more than ways to play
        rows = [
            {'game': 'ghosts=random', 'way to play': name, 'kind': kind, 'score': score}
            for name, kind, score in ((PLAN, 'plan', points + more), (RULE, 'rule', points))
        ]
        mazes.append(({'number': number, 'maze': f'maze {number}'}, rows))
    return mazes


@pytest.mark.parametrize(
    ('differences', 'mark'),
    [
        ((10.0, 12.0, 11.0), Mark.MET),
        ((-10.0, -12.0, -11.0), Mark.MISSED),
        ((10.0, -12.0, 11.0), Mark.UNDECIDED),
        ((10.0,), Mark.UNDECIDED),
    ],
)
def test_differences_are_paired_by_maze(differences: tuple[float, ...], mark: Mark) -> None:
    (found,) = transfer.present(done(*differences)).comparisons
    assert found.mark is mark
    mazes = {1: '1 maze', 3: '3 mazes'}[len(differences)]
    assert f'ghosts=random, {mazes}: {PLAN}' in found.found


def test_the_intervals_of_all_differences_hold_at_once() -> None:
    """Alone, each of these differences would be distinguishable from 0; of many one often is."""
    results = done(15.0, 35.0, 17.0, 30.0)
    (alone,) = transfer.present(results).comparisons
    assert alone.mark is Mark.MET
    for _, rows in results:
        rows += [{**rows[1], 'way to play': f'{RULE} {number}'} for number in range(40)]
    marks = [c.mark for c in transfer.present(results).comparisons]
    assert marks == [Mark.UNDECIDED] * 41


def test_the_tables_hold_every_maze() -> None:
    summary, scores, mazes = transfer.present(done(10.0, 20.0)).tables
    assert summary.rows[0]['score'] == 1515.0
    assert [row['score'] for row in scores.rows] == [1010.0, 1000.0, 2020.0, 2000.0]
    assert mazes.rows == [{'maze': n, 'text': f'maze {n}'} for n in (1, 2)]


@pytest.mark.parametrize('number', range(20))
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
    games = new_games(PacMan(maze=random_maze(rng).text), 20, rng)
    gained = sum(games.step(rng.integers(STAY, size=20), rng).reward for _ in range(2000))
    assert games.over().all()
    assert min(gained) > 0
