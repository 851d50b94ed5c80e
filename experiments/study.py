"""What a reproduction is asked to do, and what an experiment is."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
import hashlib
from pathlib import Path
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.registry import parameters_json
from humanopts_learner.demonstrations import (
    check_demonstration,
    Demonstration,
    DemonstrationError,
    group_by_option,
    Kind,
)
from humanopts_teach.bags.contents import read_demonstrations, read_domain
from humanopts_teach.bags.errors import BagError
from humanopts_teach.bags.reader import Bag, open_bag
from humanopts_teach.evaluation.bag_evaluation import FACTS
from humanopts_teach.evaluation.summary import settings_from_facts

from experiments.cells import Cell
from experiments.sections import Section


@dataclass(frozen=True)
class BagLesson:
    """One option that one person taught, in a bag."""

    bag: str  # absolute path
    participant: str
    option: str
    domain: str
    domain_parameters: str  # JSON object
    strategy: str  # of start states
    seed: int  # of the lesson
    digest: str  # of the uuids of the demonstrations


@dataclass(frozen=True)
class Study:
    """What is to be reproduced, and with whom."""

    participants: int = 6  # simulated, in each group
    seeds: int = 10  # runs of what goes by chance
    seed: int = 1  # of every random draw
    bags: tuple[BagLesson, ...] = ()  # of people; where there are any, nobody is simulated


@dataclass(frozen=True)
class Experiment:
    """One figure or table of the paper."""

    name: str  # on the command line
    title: str
    cells: Callable[[Study], list[Cell]]
    present: Callable[[Study, Mapping[str, Any]], Section]  # of results by key; some may lack


def read_bag_lessons(path: Path) -> list[BagLesson]:
    """
    Return every option that was taught in a bag.

    :raises BagError: it cannot be read, or nothing was taught in it.
    """
    bag = open_bag(path)
    domain = read_domain(bag)
    settings, _ = settings_from_facts(bag.metadata.get(FACTS, {}))
    lessons = [
        BagLesson(
            str(path.resolve()),
            participant,
            option,
            domain.name,
            parameters_json(domain),
            settings.strategy,
            settings.seed,
            hashlib.sha256(''.join(demo.uuid for demo in demos).encode()).hexdigest()[:20],
        )
        for (participant, option), demos in taught_in(bag, domain).items()
        if any(demo.kind is Kind.TRAJECTORY for demo in demos)
    ]
    if not lessons:
        raise BagError(f'{path} holds no demonstration to learn from')
    return lessons


def taught_in(bag: Bag, domain: Domain[Any]) -> dict[tuple[str, str], list[Demonstration]]:
    """Return the demonstrations in a bag that can be used, by participant and option."""
    good = []
    for demo in read_demonstrations(bag):
        try:
            check_demonstration(demo, domain)
        except DemonstrationError:
            continue  # the same that ``bag eval`` leaves out, and names
        good.append(demo)
    return group_by_option(good)
