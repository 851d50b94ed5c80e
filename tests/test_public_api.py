"""What the packages offer to people's own scripts: a dozen names each, light to import."""

from importlib import import_module
import subprocess
import sys

import pytest

PACKAGES = ('humanopts_env', 'humanopts_learner', 'humanopts_teach')
HEAVY = ('sklearn', 'scipy', 'matplotlib', 'pandas', 'gymnasium', 'rclpy', 'humanopts_interfaces')


@pytest.mark.parametrize('name', PACKAGES)
def test_every_name_that_a_package_offers_is_there(name: str) -> None:
    package = import_module(name)
    assert all(getattr(package, offered).__name__ for offered in package.__all__)
    assert set(package.__all__) <= set(dir(package))
    assert 9 <= len(package.__all__) <= 20
    with pytest.raises(AttributeError, match='nothing'):
        package.nothing  # noqa: B018


def test_importing_the_packages_imports_nothing_heavy() -> None:
    code = f'import sys, {", ".join(PACKAGES)}; print(*sys.modules)'
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True)
    assert {name.partition('.')[0] for name in done.stdout.split()}.isdisjoint(HEAVY)


def test_an_option_is_learned_and_planned_with_by_the_public_names_alone() -> None:
    code = """
from humanopts_env import generator, make_domain, reference_options
from humanopts_learner import judge_plan, learn_option, make_demonstration, plan, policy_accuracy
import sys

taxi = make_domain('taxi')
fetch = reference_options(taxi)['go to passenger and pickup']
demonstrations = []
for number in range(1, 31):
    states, actions = [taxi.reset(generator(1, 'start', number))], []
    while fetch.can_start(states[-1]):
        action = fetch.optimal_actions(states[-1])[0]
        actions.append(taxi.actions[action].name)
        states.append(taxi.step(states[-1], action, generator(1, 'step')).state)
    demonstrations.append(
        make_demonstration(
            taxi, 'pickup', states, actions, features=fetch.features, number=number
        )
    )
pickup = learn_option(demonstrations, taxi, seed=1)
assert policy_accuracy(pickup, taxi, fetch) > 0.5
policy = plan(taxi, [pickup], gamma=0.99)
assert policy.names[0] == 'pickup' and len(policy.names) == 7
performance = judge_plan(policy, seed=1, episodes=20)
assert performance.total.mean == judge_plan(plan(taxi), seed=1, episodes=20).total.mean
assert not {'rclpy', 'humanopts_interfaces', 'matplotlib'} & set(sys.modules)
"""
    subprocess.run([sys.executable, '-c', code], check=True, timeout=100)
