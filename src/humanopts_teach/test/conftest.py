"""Demonstrations by a scripted teacher, and a lesson that a test leads by hand."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from graph_support.scripted import by_reference, show
from humanopts_env.domains.base import Domain
from humanopts_env.domains.registry import make_domain, reference_options
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import Demonstration
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
    domain: Domain, option: str, count: int, seed: int = 7, participant: str = 'p1'
) -> list[Demonstration]:
    """Show an option from random states, as an expert with fixed preferences would."""
    rng = generator(seed, 'scripted teacher', option)
    choose, reference = by_reference(option, domain), reference_options(domain)[option]
    demos = []
    for number, start in enumerate(domain.sample_states(rng, count), start=1):
        demo = show(
            domain,
            start,
            choose,
            rng,
            participant=participant,
            option_name=option,
            number=number,
            chosen_features=reference.features,
        )
        demos.append(replace(demo, seconds=2.0 + 0.5 * len(demo.actions)))
    return demos


@pytest.fixture(scope='session')
def taxi() -> Domain:
    """The 5 x 5 taxi."""
    return make_domain('taxi')


@pytest.fixture(scope='session')
def taxi_lesson(taxi: Domain) -> list[Demonstration]:
    """A short lesson of two options."""
    return [demo for option in TAUGHT for demo in demonstrate(taxi, option, 12)]


@pytest.fixture(scope='session')
def pacman_lesson() -> list[Demonstration]:
    """A short lesson of one option of Pac-Man."""
    return demonstrate(make_domain('pacman'), 'go to the nearest power pellet', 12)


@pytest.fixture(scope='session')
def yard() -> Domain:
    """Pac-Man in a small maze, with short games."""
    return make_domain('pacman', {'maze': 'yard', 'max_steps': 60})


@pytest.fixture(scope='session')
def yard_lesson(yard: Domain) -> list[Demonstration]:
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
