"""Demonstrations by a scripted teacher, and a lesson that a test leads by hand."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any
import uuid

from humanopts_env.domains.base import Domain
from humanopts_env.domains.registry import make_domain, parameters_json, reference_options
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import Demonstration, Kind
from humanopts_teach.lesson.store import DemonstrationStore
import pytest
from teach_support.lesson import Table

TAUGHT = ('go to passenger and pickup', 'go to destination and dropoff')
EATING = (
    'go to the closest food',
    'avoid ghost',
    'go to the nearest power pellet',
    'eat the ghost',
)


def demonstrate(
    domain: Domain[Any], option: str, count: int, seed: int = 7, participant: str = 'p1'
) -> list[Demonstration]:
    """Show an option from random states, as an expert with fixed preferences would."""
    reference = reference_options(domain)[option]
    rng = generator(seed, 'scripted teacher', option)
    demos = []
    for number, start in enumerate(domain.sample_states(rng, count), start=1):
        states, actions, rewards = [start], [], []
        terminated = False
        while reference.can_start(states[-1]) and not terminated:
            action = reference.optimal_actions(states[-1])[0]
            outcome = domain.step(states[-1], action, rng)
            states.append(outcome.state)
            actions.append(domain.actions[action].name)
            rewards.append(outcome.reward)
            terminated = outcome.terminated
            if reference.ends(outcome.state):
                break
        demos.append(
            Demonstration(
                kind=Kind.TRAJECTORY if actions else Kind.NOT_HERE,
                uuid=str(uuid.UUID(bytes=rng.bytes(16))),
                domain=domain.name,
                domain_parameters=parameters_json(domain),
                participant=participant,
                session='s1',
                option_name=option,
                number=number,
                chosen_features=reference.features,
                feature_names=tuple(feature.name for feature in domain.features),
                features=tuple(tuple(domain.feature_values(s).tolist()) for s in states),
                states=tuple(domain.encode(state) for state in states),
                actions=tuple(actions),
                rewards=tuple(rewards),
                terminated=terminated,
                seconds=2.0 + 0.5 * len(actions),
            )
        )
    return demos


@pytest.fixture(scope='session')
def taxi() -> Domain[Any]:
    """The 5 x 5 taxi."""
    return make_domain('taxi')


@pytest.fixture(scope='session')
def taxi_lesson(taxi: Domain[Any]) -> list[Demonstration]:
    """A short lesson of two options."""
    return [demo for option in TAUGHT for demo in demonstrate(taxi, option, 12)]


@pytest.fixture(scope='session')
def pacman_lesson() -> list[Demonstration]:
    """A short lesson of one option of Pac-Man."""
    return demonstrate(make_domain('pacman'), 'go to the nearest power pellet', 12)


@pytest.fixture(scope='session')
def yard() -> Domain[Any]:
    """Pac-Man in a small maze, with short games."""
    return make_domain('pacman', {'maze': 'yard', 'max_steps': 120})


@pytest.fixture(scope='session')
def yard_lesson(yard: Domain[Any]) -> list[Demonstration]:
    """A short lesson of four options."""
    return [demo for option in EATING for demo in demonstrate(yard, option, 12)]


@pytest.fixture
def store(tmp_path: Path) -> Iterator[DemonstrationStore]:
    """An empty folder of demonstrations."""
    with DemonstrationStore(tmp_path) as opened:
        yield opened


@pytest.fixture
def table(store: DemonstrationStore) -> Table:
    """A lesson with the person, the game and the learner in the hands of the test."""
    return Table(store)
