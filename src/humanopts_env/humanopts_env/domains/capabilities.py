"""
Optional capabilities of domains, used by the learner and the teaching tools.

A domain has a capability by having the method or attribute; nothing is registered.

- ``HasBoard``: it has a board that can be drawn.
- ``HasPlanningFeatures``: its games have features for planning alone.
- ``HasPrimitiveColumns``: it names what plans with primitive actions see of its features.
- ``HasSearchSpace``: it defines where subgoals of automatic options are searched for.
- ``HasTeachingDefaults``: it names the options to teach.
- ``HasBaselines``: it names the baselines of plans, and the variants of the game to compare in.
- ``HasActionMask``: it says which actions can change something, if states cannot be listed.
- ``HasStepEffects``: it describes the effect of a step.
- ``HasExplanation``: it explains the game and the signs on the board.
- ``HasFeatureGroups``: it groups its features, so that a person is asked about a group first.

``humanopts_env.testing`` tests each of them in every domain that has it.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

from humanopts_env.arrays import Ints
from humanopts_env.board import Board
from humanopts_env.domains.base import ActableDomain, Parameter, shown_values
from humanopts_env.domains.search_space import SearchSpace
import numpy as np
from numpy.typing import NDArray


@runtime_checkable
class HasBoard(Protocol):
    """A domain that can be drawn."""

    def board(self, state: Any, shown: Collection[str] | None = None) -> Board:
        """
        Return what is where in a state.

        :param shown: names of the features that may be revealed, and nothing else; None: all.
        """


def board_of(domain: ActableDomain, state: Any, shown: Collection[str] | None = None) -> Board:
    """Return the board of a state; a board without cells lists the features that are shown."""
    if isinstance(domain, HasBoard):
        return domain.board(state, shown)
    return Board(notes=in_words(shown_values(domain, state, shown)))


def in_words(values: Mapping[str, str], drawn: Collection[str] = ()) -> tuple[str, ...]:
    """
    Return features and their values in words.

    :param drawn: names of those that are left out, since they can be seen on the board.
    """
    return tuple(
        f'{name.replace("_", " ")}: {value}' for name, value in values.items() if name not in drawn
    )


@runtime_checkable
class HasPlanningFeatures(Protocol):
    """
    Games with features that planning needs and people are not asked about.

    They have few values, so that abstract states are visited often.
    """

    def planning_features(self) -> NDArray[np.integer]:
        """Return (N, P): their values, whole numbers from 0."""


@runtime_checkable
class HasPrimitiveColumns(Protocol):
    """A domain that names the columns of abstract states for plans with primitive actions."""

    primitive_columns: Sequence[str]  # features with bins, as in ``PlanRequest.columns``


@runtime_checkable
class HasSearchSpace(Protocol):
    """
    A domain that defines where subgoals are searched for.

    In other domains with an enumerable state space, every state is a cell of its own.
    """

    def search_space(self) -> SearchSpace:
        """Return the states of the random tasks, and the cell and situation of each."""


@dataclass(frozen=True)
class TeachingDefaults:
    """What is taught by default."""

    options: tuple[str, ...] = ()  # names of the reference options that a demo teaches; empty: all


@runtime_checkable
class HasTeachingDefaults(Protocol):
    """A domain with teaching defaults of its own."""

    teaching: TeachingDefaults


@dataclass(frozen=True)
class Baselines:
    """The baselines that plans are compared with."""

    variants: Mapping[str, Mapping[str, Parameter]] = field(default_factory=dict)
    """Changed parameters of each variant of the game to compare in, by the variant's name."""
    paper_options: tuple[str, ...] = ()  # names, for a plan with these options alone
    heuristic: Callable[[Any], Ints] | None = None
    """A rule written by hand: returns the action (N,) in each of N ``Games``."""


@runtime_checkable
class HasBaselines(Protocol):
    """A domain that names the baselines of plans."""

    def baselines(self) -> Baselines:
        """Return the baselines in this variant of the game."""


@runtime_checkable
class HasActionMask(Protocol):
    """A domain that says which actions can change something."""

    def action_mask(self, state: Any) -> NDArray[np.int8]:
        """Return (A,): 1 for those that can."""


@dataclass(frozen=True, slots=True)
class StepEffect:
    """What one step did, for the person who watches."""

    text: str  # a few words without a full stop, such as "picked the passenger up"
    changed: bool = True  # False: it had no effect, as far as the person's action goes


@runtime_checkable
class HasStepEffects(Protocol):
    """A domain that describes the effect of a step."""

    def step_effect(self, state: Any, action: int, successor: Any) -> StepEffect:
        """Return what a step from ``state`` did that led to ``successor``."""


def step_effect(domain: ActableDomain, state: Any, action: int, successor: Any) -> StepEffect:
    """Return the effect of a step; by default the name of its action."""
    if isinstance(domain, HasStepEffects):
        return domain.step_effect(state, action, successor)
    return plain_effect(domain, state, action, successor)


def plain_effect(domain: ActableDomain, state: Any, action: int, successor: Any) -> StepEffect:
    """Return the name of the action of a step, or that nothing changed."""
    if state == successor:
        return StepEffect('nothing changed', changed=False)
    return StepEffect(domain.actions[action].name)


def move_effect(asked: str, went: str, *, free: bool = False) -> StepEffect:
    """
    Return what a move in a grid did.

    :param asked: the direction that was asked for.
    :param went: the direction of the cell that was entered; empty: none was.
    :param free: whether a cell could have been entered in the direction that was asked for.
    """
    if not went:
        wall = 'slid into a wall' if free else 'wall'
        return StepEffect(f'{wall}: nothing moved', changed=False)
    return StepEffect(f'went {went}' if went == asked else f'slid {went}')


@dataclass(frozen=True, slots=True)
class FeatureGroup:
    """Features of one thing."""

    words: str  # completes "anything about ...": the ghosts
    features: tuple[str, ...]  # their names, two or more


@runtime_checkable
class HasFeatureGroups(Protocol):
    """A domain with many features: people are asked about groups of them first."""

    feature_groups: Sequence[FeatureGroup]  # a feature is in one group at most


def feature_groups(domain: ActableDomain) -> Sequence[FeatureGroup]:
    """Return the groups of a domain's features; empty where it has none."""
    return domain.feature_groups if isinstance(domain, HasFeatureGroups) else ()


@runtime_checkable
class HasExplanation(Protocol):
    """A domain that explains the game to a person."""

    # Signs on the board, each with its meaning; the first sign is empty: what to do.
    explanation: Sequence[tuple[str, str]]


def explanation(domain: ActableDomain) -> Sequence[tuple[str, str]]:
    """Return the signs of a domain and their meanings; empty where it has no words for them."""
    return domain.explanation if isinstance(domain, HasExplanation) else ()
