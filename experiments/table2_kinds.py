"""The rows of Table 2: games, and what is planned with in them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from humanopts_learner.planning.action_sets import (
    AUTOMATIC,
    AUTOMATIC_AND_PRIMITIVE,
    HUMAN,
    HUMAN_AND_PRIMITIVE,
    PRIMITIVE,
)
from humanopts_learner.planning.arbitration import Execution

NOBODY, PERSON, MACHINE = 'nobody', 'person', 'machine'  # whose options
AS_IN_PAPER = 'human, without eating ghosts'  # in Pac-Man


@dataclass(frozen=True)
class Game:
    """One game in which all kinds of plan are compared."""

    name: str
    domain: str
    exact: bool  # models; else they are sampled
    parameters: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Kind:
    """What is planned with, and how the policy is carried out."""

    name: str
    whose: str  # options
    action_set: str
    execution: Execution = Execution.RUN_TO_END
    of_section_7: bool = False  # only options that the paper's participants taught


TAXI = Game('Taxi', 'taxi', exact=True)
UNIFORM = Game('Pac-Man, random ghosts', 'pacman', exact=False)
CHASE = Game('Pac-Man, chasing ghosts', 'pacman', exact=False, parameters={'ghosts': 'chase'})
GAMES = (TAXI, UNIFORM, CHASE)

TO_END = Kind('human', PERSON, HUMAN)
KINDS = (
    Kind('primitive', NOBODY, PRIMITIVE),
    TO_END,
    Kind(AS_IN_PAPER, PERSON, HUMAN, of_section_7=True),
    Kind('automatic', MACHINE, AUTOMATIC),
    Kind('human + primitive', PERSON, HUMAN_AND_PRIMITIVE),
    Kind('automatic + primitive', MACHINE, AUTOMATIC_AND_PRIMITIVE),
    Kind('human, interrupted', PERSON, HUMAN, Execution.INTERRUPTED),
    Kind('human, modular (greatest mass)', PERSON, HUMAN, Execution.MODULAR_MASS),
    Kind('human, modular (strongest)', PERSON, HUMAN, Execution.MODULAR_STRONGEST),
)
OTHER_WAYS = tuple(kind for kind in KINDS if kind.execution is not Execution.RUN_TO_END)
