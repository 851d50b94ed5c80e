"""Our domains as Gymnasium environments, and Gymnasium's Taxi as a check of ours."""

from typing import Any
import warnings

import gymnasium
from gymnasium.utils.env_checker import check_env
from humanopts_env.domains.base import DomainError
from humanopts_env.domains.registry import domain_names
from humanopts_env.gym_env import DomainEnv, ENVIRONMENTS, register_all
import numpy as np
import pytest


def make(name: str = 'humanopts/Taxi-v0', **parameters: Any) -> Any:
    """Make our Taxi as a user does, or another environment."""
    return gymnasium.make(name, **parameters)


@pytest.mark.parametrize('name', [n for n, d in ENVIRONMENTS.items() if d in domain_names()])
def test_gymnasiums_checker_is_satisfied(name: str) -> None:
    """Without a single warning, by every environment whose domain is installed."""
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        check_env(make(name, render_mode='ansi').unwrapped)


def test_the_rooms_are_registered() -> None:
    """Under their own id."""
    assert gymnasium.spec('humanopts/Rooms-v0').kwargs == {'domain': 'rooms'}


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


def test_it_takes_the_domains_parameters() -> None:
    """A grid of another size."""
    env = make(rows=6, cols=7)
    assert env.observation_space.n == 6 * 7 * 20
    with pytest.raises(DomainError, match='rows'):
        make(rows=2)


def test_an_episode_is_played_to_its_end() -> None:
    """From a state given as text, and cut off at the domain's max_steps."""
    env = make(render_mode='ansi')
    env.reset(seed=0, options={'state': 'taxi 4,3 passenger aboard destination B'})
    assert '■' in str(env.render())
    assert env.step(5)[1:4] == (1.0, True, False)
    env.reset(seed=0)
    assert [env.step(1)[3] for _ in range(200)] == [False] * 199 + [True]


def test_the_same_seed_begins_in_the_same_state() -> None:
    """And others in others."""
    env = make()
    firsts = [env.reset(seed=seed)[0] for seed in (1, 1, 2, 3)]
    assert firsts[0] == firsts[1]
    assert len(set(firsts)) > 1


def test_only_domains_whose_states_can_be_listed_are_made() -> None:
    """An unknown one is refused by name."""
    with pytest.raises(DomainError, match='no domain'):
        DomainEnv('chess')
