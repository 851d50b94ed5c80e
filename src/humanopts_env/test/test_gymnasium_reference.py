"""The reference options of environments do what they say, from resets that were never seen."""

from collections.abc import Mapping
from typing import Any

from humanopts_env.domains.base import Domain, shown_values
from humanopts_env.domains.gymnasium_reference import WatchedOption
from humanopts_env.domains.reference import ReferenceOption
from humanopts_env.domains.registry import make_domain, reference_options
from humanopts_env.seeding import generator
from humanopts_env.testing import ReferenceContract
import pytest

MISSIONS = {  # by environment: its options in order, and the mean steps of the whole task
    'MiniGrid-DoorKey-8x8-v0': (['get the key', 'open the locked door', 'go to the goal'], 17),
    'MiniGrid-KeyCorridorS3R2-v0': (['get the key', 'open the locked door', 'get the object'], 18),
    'MiniGrid-UnlockPickup-v0': (['get the key', 'open the locked door', 'get the object'], 18),
    'MiniGrid-Unlock-v0': (['get the key', 'open the locked door'], 10),
    'MiniGrid-LockedRoom-v0': (['get the key', 'open the locked door', 'go to the goal'], 39),
    'MiniGrid-LavaCrossingS9N2-v0': (['go to the goal'], 16),
    'MiniGrid-LavaGapS7-v0': (['go to the goal'], 11),
    'MiniGrid-FourRooms-v0': (['go to the goal'], 16),
    'MiniGrid-MultiRoom-N4-S5-v0': (['go to the goal'], 31),
    'MiniGrid-DistShift1-v0': (['go to the goal'], 13),
    'MiniGrid-Empty-Random-6x6-v0': (['go to the goal'], 5),
    'LunarLander-v3': (['land'], 230),
    'MountainCar-v0': (['drive to the flag'], 120),
    'Acrobot-v1': (['swing up'], 85),
    'CartPole-v1': (['straighten the pole'], None),  # no end of the task
}
SEEDS = 8


class TestCartPole(ReferenceContract):
    def make(self) -> Domain:
        return make_domain('gymnasium:CartPole-v1')

    def options(self, domain: Domain) -> Mapping[str, ReferenceOption]:
        return reference_options(domain)


class TestCrossing(TestCartPole):
    def make(self) -> Domain:
        return make_domain('gymnasium:MiniGrid-SimpleCrossingS9N1-v0', {'max_episode_steps': 40})


def run(domain: Domain, option: WatchedOption, state: Any) -> tuple[Any, int]:
    rng, steps = generator(0, 'unused'), 0
    while not option.ends(state) and not state.over and steps < domain.max_steps:
        state = domain.step(state, option.optimal_actions(state)[0], rng).state
        steps += 1
    return state, steps


@pytest.mark.parametrize('name', MISSIONS)
def test_one_option_after_the_other_does_the_whole_task(name: str) -> None:
    names, mean = MISSIONS[name]
    domain = make_domain(f'gymnasium:{name}')
    options: Mapping[str, Any] = reference_options(domain)
    assert [*options] == names
    total = 0
    for seed in range(SEEDS):
        state = domain.reset(generator(seed, 'task'))
        for option in options.values():
            state, steps = run(domain, option, state)
            total += steps
            assert option.reached(state)
        assert mean is None or state.over
    assert mean is None or total / SEEDS == pytest.approx(mean, rel=0.25)


def test_an_end_of_the_task_that_was_not_wanted_is_not_an_end_of_the_option() -> None:
    domain = make_domain('gymnasium:MiniGrid-LavaGapS5-v0')
    (option,) = reference_options(domain).values()
    assert isinstance(option, WatchedOption)
    state = domain.reset(generator(0, 'lava'))
    rng = generator(0, 'walk')
    while not state.over:
        state = domain.step(state, int(rng.integers(3)), rng).state
    assert shown_values(domain, state)['lava_distance'] == '0'
    assert (option.can_start(state), option.ends(state)) == (False, False)


def test_environments_without_a_known_way_have_no_options() -> None:
    assert reference_options(make_domain('gymnasium:FrozenLake-v1')) == {}
    assert reference_options(make_domain('gymnasium:MiniGrid-Fetch-5x5-N2-v0')) == {}
