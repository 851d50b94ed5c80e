"""Transfer to other mazes: a real trial of small numbers, and comparisons of known results."""

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
import pandas as pd
import pytest

from experiments import transfer
from experiments.people import BagLesson, OwnedOptions, Study
from experiments.random_mazes import random_maze
from experiments.report import Mark

PLAN, RULE = 'human, 5 options, interrupted, 4-fold steps', 'hand-written rule'


def test_there_are_two_mazes_for_each_seed_and_people_take_turns() -> None:
    """A user's own mazes replace them; without options of the game there is nothing."""
    trials = transfer.trials(Study(participants=3, seeds=4, seed=2))
    mazes = [trial.parameters['maze'] for trial in trials]
    assert len(set(mazes)) == len(mazes) == 8
    assert mazes == [t.parameters['maze'] for t in transfer.trials(Study(1, 4, 2))]
    people = [trial.parameters['teacher']['person']['code'] for trial in trials]
    assert sorted({people.count(code) for code in people}) == [2, 3]
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
    rows = trial.compute({**trial.parameters, 'steps': 800, 'games': 4})
    assert json.loads(json.dumps(rows)) == rows
    assert [(row['game'], row['way to play']) for row in rows] == [
        (game, way) for game in ('ghosts=random', 'ghosts=chase') for way in ways
    ]
    assert rows[1]['score'] > 500


def results(*differences: float, rules: int = 1) -> pd.DataFrame:
    """Return results in which the plan scores more than the rules, by maze."""
    return pd.DataFrame(
        {
            'maze': number,
            'text': f'maze {number}',
            'game': 'ghosts=random',
            'way to play': name,
            'kind': kind,
            'score': 1000.0 * number + points,  # mazes differ much more than ways to play
        }
        for number, more in enumerate(differences, start=1)
        for name, kind, points in (
            (PLAN, 'plan', more),
            *((f'rule {n}', 'rule', 0.0) for n in range(rules)),
        )
    )


@pytest.mark.parametrize(
    ('differences', 'rules', 'mark'),
    [
        ((10.0, 12.0, 11.0), 1, Mark.MET),
        ((-10.0, -12.0, -11.0), 1, Mark.MISSED),
        ((10.0, -12.0, 11.0), 1, Mark.UNDECIDED),
        ((10.0,), 1, Mark.UNDECIDED),
        ((15.0, 35.0, 17.0, 30.0), 1, Mark.MET),
        ((15.0, 35.0, 17.0, 30.0), 41, Mark.UNDECIDED),  # of many differences one often is met
    ],
)
def test_differences_are_paired_by_maze_and_hold_at_once(
    differences: tuple[float, ...], rules: int, mark: Mark
) -> None:
    section = transfer.present(results(*differences, rules=rules))
    assert [c.mark for c in section.comparisons] == [mark] * rules
    mazes = '1 maze' if len(differences) == 1 else f'{len(differences)} mazes'
    assert f'ghosts=random, {mazes}: {PLAN}' in section.comparisons[0].found
    summary, scores, mazes_table = section.tables
    mean = 500.0 * (len(differences) + 1) + sum(differences) / len(differences)
    assert summary.rows[0]['score'] == pytest.approx(mean)
    assert len(scores.rows) == len(differences) * (rules + 1)
    assert mazes_table.rows[0] == {'maze': 1, 'text': 'maze 1'}


def test_every_maze_is_whole_can_be_walked_round_and_is_that_of_the_seed() -> None:
    mazes = [random_maze(generator(1, 'test', 'maze', n)) for n in range(20)]
    assert [maze.text for maze in mazes[:2]] == [
        random_maze(generator(1, 'test', 'maze', n)).text for n in range(2)
    ]
    assert len({maze.text for maze in mazes}) == 20
    assert {len(maze.text.splitlines()) for maze in mazes} == {9, 11, 13}
    for maze in mazes:
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


def test_a_maze_is_played_to_the_end_by_random_moves() -> None:
    rng = generator(3, 'test', 'play')
    games = new_games(PacMan(maze=random_maze(rng).text), 20, rng)
    gained = sum(games.step(rng.integers(STAY, size=20), rng).reward for _ in range(2000))
    assert games.over().all()
    assert min(gained) > 0
