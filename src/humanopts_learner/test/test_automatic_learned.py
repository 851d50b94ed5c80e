"""Automatic options as learned ones: the same everywhere, saved, chosen and planned with."""

from dataclasses import replace
from functools import cache
from typing import Any

from humanopts_env.domains.base import DomainError
from humanopts_env.domains.registry import make_domain
from humanopts_env.domains.rooms import Rooms
from humanopts_env.domains.taxi import Taxi
from humanopts_learner.automatic.config import Extraction
from humanopts_learner.automatic.extract import (
    AutomaticOptions,
    find_options,
    to_learned_options,
)
from humanopts_learner.options.files import option_from_json, option_to_json
from humanopts_learner.options.option import LearnedOption, tabulate
from humanopts_learner.planning.exact import make_exact_plan
from humanopts_learner.planning.plan import make_plan
from humanopts_learner.planning.request import (
    batch_games,
    NoOptionsError,
    PlanError,
    PlanRequest,
    select_options,
)
from humanopts_learner.planning.sampled.plan import make_sampled_plan
import numpy as np
import pytest

QUICK = Extraction(tasks=100, train_episodes=100, option_episodes=500)


@cache
def found(name: str) -> AutomaticOptions:
    """Return what a quick search finds in a domain."""
    return find_options(make_domain(name), 0, QUICK)


@cache
def options(name: str) -> list[LearnedOption]:
    """Return the same as learned options."""
    return to_learned_options(make_domain(name), found(name))


@pytest.mark.parametrize('name', ['taxi', 'rooms', 'gymnasium:CliffWalking-v1'])
def test_trees_say_what_the_tables_say_wherever_an_episode_goes_on(name: str) -> None:
    domain, space = make_domain(name), found(name).space
    going = space.reached & ~space.over
    for option, learned in zip(found(name).options, options(name), strict=True):
        said = tabulate(learned, domain)  # type: ignore[arg-type]
        assert (said.initiation == option.initiation)[going].all()
        assert (said.termination == option.termination)[going].all()
        assert (said.action == option.action)[option.initiation].all()
        assert learned.max_steps == option.max_steps


def test_options_of_pacman_see_his_place_and_do_the_same_in_every_game() -> None:
    domain = make_domain('pacman')
    games, rng = batch_games(domain), np.random.default_rng(0)
    batch = games.batch_reset(200, rng)
    for _ in range(30):
        games.batch_step(batch, rng.integers(4, size=200), rng)
    rows = games.batch_features(batch)
    cells = found('pacman').space.states_of(rows)
    for option, learned in zip(found('pacman').options, options('pacman'), strict=True):
        can = option.initiation[cells]
        assert learned.features == ('pacman_row', 'pacman_col')
        assert (learned.can_start(rows) == can).all()
        assert (learned.greedy_action(rows) == option.action[cells])[can].all()
        assert (learned.ends(rows) == option.termination[cells]).all()


def test_an_option_depends_on_no_feature_that_it_can_do_without() -> None:
    for option in options('taxi'):
        assert 'blocked_moves' not in option.features
        assert 'taxi_row' in option.features
    assert {option.features for option in options('rooms')} == {('row', 'col')}


def test_what_the_features_do_not_tell_apart_is_refused() -> None:
    seen = found('rooms')
    dark = replace(seen, space=replace(seen.space, rows=np.zeros_like(seen.space.rows)))
    with pytest.raises(DomainError, match='of rooms do not tell what'):
        to_learned_options(Rooms(), dark)


def test_a_file_keeps_an_automatic_option_without_demonstrations() -> None:
    option = options('taxi')[0]
    again, demonstrations = option_from_json(option_to_json(option))
    assert again == option
    assert not demonstrations
    assert (again.participant, again.n_demonstrations) == ('automatic', 0)


@pytest.mark.parametrize('action_set', ['automatic', 'automatic+primitive'])
def test_plans_of_learned_form_and_of_tables_are_the_same(action_set: str) -> None:
    taxi = Taxi()
    plan: Any = make_plan(taxi, options('taxi'), PlanRequest(action_set))
    tabled = make_exact_plan(taxi, found('taxi').options, PlanRequest(action_set))
    space = found('taxi').space
    going = space.reached & ~space.over
    assert (plan.solution.values == tabled.solution.values)[going].all()
    assert (plan.solution.best == tabled.solution.best)[going].all()
    assert plan.first_fallback == (len(plan.options) if action_set == 'automatic' else 9 + 6)


def test_fallbacks_of_automatic_options_are_where_none_can_start() -> None:
    sampled = make_sampled_plan(
        make_domain('pacman'),
        options('pacman'),
        PlanRequest('automatic', game_steps=60_000, seed=0, max_sweeps=100),
    )
    assert sampled.first_fallback == len(options('pacman'))


def test_people_are_not_taken_for_machines() -> None:
    with pytest.raises(PlanError, match="must begin with 'automatic', not 'ann'"):
        to_learned_options(Rooms(), found('rooms'), 'ann')


def test_sets_choose_between_what_people_taught_and_what_was_found() -> None:
    auto, other = options('rooms')[:2]
    taught = replace(auto, name='out', participant='ann')
    second = replace(other, participant='automatic 2')
    both = [taught, auto, other]
    assert select_options(both, 'human') == [taught]
    assert select_options(both, 'automatic') == [auto, other]
    assert select_options(both, 'automatic+primitive', names=[other.name]) == [other]
    assert select_options([*both, second], 'automatic', 'automatic 2') == [second]
    with pytest.raises(PlanError, match='name one of automatic, automatic 2'):
        select_options([*both, second], 'automatic')
    with pytest.raises(NoOptionsError, match='extract them first'):
        make_plan(Rooms(), select_options([taught], 'automatic'), PlanRequest('automatic'))
