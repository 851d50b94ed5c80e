"""The search for settings: a real trial of small numbers, and what is said of known results."""

import json
from typing import Any

from graph_support.scripted import expert
from humanopts_env.domains.capabilities import PlanSettings
from humanopts_env.domains.pacman.domain import PacMan
from humanopts_env.domains.pacman.maze import load_maze
from humanopts_env.domains.registry import make_domain
from humanopts_learner.options.learn import learn_option
from humanopts_learner.planning.request import Sampling
import numpy as np
import pytest

from experiments import settings, transfer
from experiments.people import BagLesson, OwnedOptions, Study
from experiments.settings import ACTION_SETS, ALL, USUAL

BEST = 'gamma 0.95, penalty 30, shrinkage 1000'


def test_there_is_a_maze_for_each_seed_that_no_other_experiment_plays_in() -> None:
    study = Study(participants=3, seeds=6, seed=2)
    trials = settings.trials(study)
    mazes = [trial.parameters['maze'] for trial in trials]
    others = {trial.parameters['maze'] for trial in transfer.trials(study)}
    assert len(set(mazes)) == 6
    assert not others & {*mazes}
    assert [trial.parameters['ghosts'] for trial in trials] == ['chase', 'random'] * 3
    assert trials[:4] == settings.trials(Study(3, 4, 2))
    lesson = BagLesson('/bag', 'p1', 'go', 'taxi', '{}', 'failures', 1, 'x')
    assert settings.trials(Study(bags=(lesson,))) == []


@pytest.mark.parametrize('ghosts', ['random', 'chase'])
def test_the_usual_setting_and_those_found_by_hand_are_among_those_tried(ghosts: str) -> None:
    domain = make_domain('pacman', {'ghosts': ghosts})
    tried = settings.settings_to_try(domain)
    each = [(one.gamma, Sampling(**one.sampling)) for one in tried.values()]
    assert len(tried) == 12 + 3
    assert each.index((domain.gamma, Sampling())) == list(tried).index(USUAL)
    by_hand = domain.baselines()
    assert list(tried.values())[-3:] == [
        by_hand.primitive,
        by_hand.interrupted,
        by_hand.interrupted_mixture,
    ]


def test_every_action_set_is_tried_with_every_setting(monkeypatch: pytest.MonkeyPatch) -> None:
    domain = PacMan(maze='yard', max_steps=40)
    taught = tuple(
        learn_option(expert(name, 10, domain), domain, 1)
        for name in ('go to the closest food', 'avoid ghost')
    )
    owned = OwnedOptions(taught)
    sets = {name: ACTION_SETS[name] for name in ('primitive', 'human, interrupted')}
    monkeypatch.setattr(settings, 'taught_in_usual_maze', lambda teacher: owned)
    monkeypatch.setattr(settings, 'options_of', lambda owner, domain: OwnedOptions())
    monkeypatch.setattr(settings, 'ACTION_SETS', sets)
    some = {USUAL: PlanSettings(0.9, {}), BEST: PlanSettings(0.95, {'penalty': 30.0})}
    monkeypatch.setattr(settings, 'settings_to_try', lambda domain: some)
    trial, *_ = settings.trials(Study(participants=1, seeds=1))
    small = {'maze': load_maze('yard').text, 'steps': 800, 'primitive_steps': 800, 'games': 4}
    rows = trial.compute({**trial.parameters, **small})
    assert json.loads(json.dumps(rows)) == rows
    assert [(row['action set'], row['setting']) for row in rows] == [
        (name, setting) for name in sets for setting in some
    ]


def done(scores: dict[str, list[float]]) -> list[tuple[dict[str, Any], list[dict[str, Any]]]]:
    """Return results in which all action sets score alike, by setting and maze."""
    count = len(next(iter(scores.values())))
    return [
        (
            {'number': maze, 'ghosts': 'random'},
            [
                {'action set': name, 'setting': setting, 'score': values[maze]}
                for name in ACTION_SETS
                for setting, values in scores.items()
            ],
        )
        for maze in range(count)
    ]


def test_a_setting_is_judged_in_mazes_that_it_was_not_chosen_in() -> None:
    """
    In each maze one of two settings is lucky, so that the other is best in the other two mazes.

    Chosen in all mazes, the best would have 15 points more than the usual one.
    """
    by_hand = {name: [0.0] * 3 for name in settings.BY_HAND.values()}
    scores = {USUAL: [95.0] * 3, 'a': [130.0, 0.0, 200.0], 'b': [130.0, 200.0, 0.0], **by_hand}
    choices, means, summary, each = settings.present(done(scores)).tables
    assert [row['action set'] for row in choices.rows] == [*ACTION_SETS, ALL]
    for row in choices.rows:
        assert row['best setting'] == 'a'  # the first of equals
        assert row['score'] == pytest.approx((130 + 0 + 0) / 3)
        assert row['usual: more'] == pytest.approx((35 - 95 - 95) / 3)
        above = 4.302653 * np.std([35, -95, -95], ddof=1) / np.sqrt(3)  # t(0.975, 2)
        assert row['usual: high'] == pytest.approx(row['usual: more'] + above)
        assert row['usual: low'] == pytest.approx(row['usual: more'] - above)
    assert [row['by hand'] for row in choices.rows] == [0.0, None, 0.0, 0.0, None, None]
    assert means.rows[1] == {'setting': 'a', **dict.fromkeys(ACTION_SETS, 110.0)}
    assert len(summary.rows) == len(ACTION_SETS) * len(scores)
    assert len(each.rows) == 3 * len(summary.rows)


def test_one_maze_alone_has_no_choice() -> None:
    one = settings.present(done({USUAL: [1.0], BEST: [2.0]}))
    assert 'settings-choices' not in [table.name for table in one.tables]
