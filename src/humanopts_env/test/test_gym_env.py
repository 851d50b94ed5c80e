"""Our domains as Gymnasium environments, and Gymnasium's Taxi as a check of ours."""

from typing import Any
import warnings

import gymnasium
from gymnasium.utils.env_checker import check_env
from humanopts_env.domains.base import DomainError
from humanopts_env.domains.pacman.domain import PacMan
from humanopts_env.domains.registry import make_domain
from humanopts_env.game import Command, Game, Source
from humanopts_env.gym_env import DomainEnv, ENVIRONMENTS, register_all, spec_of
from humanopts_env.seeding import generator
import numpy as np
import pytest


def make(name: str = 'humanopts/Taxi-v0', **parameters: Any) -> Any:
    """Make our Taxi as a user does, or another environment."""
    return gymnasium.make(name, **parameters)


@pytest.mark.parametrize('name', ENVIRONMENTS)
def test_gymnasiums_checker_is_satisfied(name: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        env = make(name, render_mode='ansi').unwrapped
        for call in (lambda: env.step(0), env.render):
            with pytest.raises(gymnasium.error.ResetNeeded, match='reset'):
                call()
        check_env(env)


def test_it_is_found_by_module_and_name_and_registered_once() -> None:
    """Gymnasium warns about a second registration."""
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        register_all()
    env = make('humanopts_env.gym_env:humanopts/Taxi-v0')
    assert isinstance(env.unwrapped, DomainEnv)


def test_the_table_is_gymnasiums_own_but_for_the_rewards() -> None:
    """All 500 x 6 transitions, and the start states."""
    ours, theirs = make().unwrapped, make('Taxi-v4').unwrapped
    assert ours.P.keys() == theirs.P.keys()
    for state, actions in theirs.P.items():
        assert ours.P[state].keys() == actions.keys()
        for action, entries in actions.items():
            without_rewards = [(p, s, done) for p, s, _, done in ours.P[state][action]]
            assert without_rewards == [(p, s, done) for p, s, _, done in entries]
    np.testing.assert_allclose(ours.initial_state_distrib, theirs.initial_state_distrib)


def test_the_rewards_are_the_papers() -> None:
    """Gymnasium's 20 is 1; its -1 for a legal pickup is 0; all else is -1."""
    ours, theirs = make().unwrapped, make('Taxi-v4').unwrapped
    pickup = 4
    for state, actions in theirs.P.items():
        for action, [(_, successor, their_reward, _)] in actions.items():
            legal_pickup = action == pickup and successor != state
            expected = 0 if legal_pickup else 1 if their_reward == 20 else -1
            assert ours.P[state][action][0][2] == expected


def test_an_episode_is_played_to_its_end() -> None:
    """From a state given as text, and cut off at the domain's max_steps."""
    env = make(render_mode='ansi')
    env.reset(seed=0, options={'state': 'taxi 4,3 passenger aboard destination B'})
    assert '■' in str(env.render())
    assert env.step(5)[1:4] == (1.0, True, False)
    env.reset(seed=0)
    assert [env.step(1)[3] for _ in range(200)] == [False] * 199 + [True]


def test_the_action_mask_of_taxi_is_gymnasiums_own() -> None:
    """In all 400 states in which a task is under way."""
    ours, theirs = make().unwrapped, make('Taxi-v4').unwrapped
    for number in np.flatnonzero(~ours.domain.over()).tolist():
        state = ours.domain.state_at(number)
        assert ours.action_mask(state).tolist() == theirs.action_mask(number).tolist()


def test_pacman_is_observed_by_its_features() -> None:
    """In the order of the domain's features, and with the maze and the ghosts that are asked."""
    env = make('humanopts/PacMan-v0', ghosts='chase', maze='yard', lives=1)
    domain = env.unwrapped.domain
    assert dict(domain.parameters) == dict(PacMan('yard', 'chase', lives=1).parameters)
    observation, info = env.reset(seed=0)
    assert observation.tolist() == domain.feature_values(domain.rules.start()).tolist()
    assert env.observation_space.nvec.tolist() == [len(f.values) for f in domain.features]
    legal = domain.features[-1].values[observation[-1]].split(' and ')
    names = [action.name for action in domain.actions]
    assert [names[move] for move in np.flatnonzero(info['action_mask'])] == legal
    with pytest.raises(DomainError, match='ghosts'):
        make('humanopts/PacMan-v0', ghosts='slow')


@pytest.mark.parametrize('start', [False, True])
@pytest.mark.parametrize('name', ['taxi', 'rooms', 'pacman'])
def test_game_seed_gives_the_episode_of_the_node_game(name: str, start: bool) -> None:
    """Its start state where none is given, and its chance."""
    domain = make_domain(name)
    text = domain.encode(domain.reset(generator(3, 'start'))) if start else ''
    env, game = spec_of(domain).make().unwrapped, Game(domain)
    transition = game.reset(text, 9, Source.MACHINE).transition
    env.reset(options={'game_seed': 9, **({'state': text} if start else {})})
    rng = generator(0, 'gymnasium')
    while transition is not None and transition.open and transition.step < 30:
        action = int(rng.integers(4))
        at = transition.episode, transition.step
        game.command(Command('/x#1', 1, Source.MACHINE, *at, domain.actions[action].name))
        transition = game.transition
        observed, *outcome, _ = env.step(action)
        assert np.array_equal(observed, env.observe(domain.decode(transition.state)))
        assert outcome == [transition.reward, transition.terminated, transition.truncated]


def test_a_specification_makes_the_same_domain() -> None:
    for domain in (make_domain('gymnasium:FrozenLake-v1'), make_domain('taxi', {'rows': 7})):
        made = spec_of(domain).make().unwrapped.domain
        assert (made.name, made.parameters) == (domain.name, domain.parameters)
