"""
Optional capabilities of domains, used by the learner and the teaching tools.

A domain has a capability if it has the method or attribute; nothing is registered.

- ``HasBoard``: a board to draw.
- ``HasPicture``: a picture of a state, in which features cannot be hidden.
- ``HasPlanningFeatures``: games with features only for planning.
- ``HasPrimitiveColumns``: the features used by plans with primitive actions.
- ``HasSearchSpace``: the search space for subgoals of automatic options.
- ``HasTeachingDefaults``: the options to teach.
- ``HasBaselines``: the baselines of plans, and the variants of the game for comparisons.
- ``HasActionMask``: the actions that can change the state, if states cannot be listed.
- ``HasStepEffects``: descriptions of the effects of steps.
- ``HasCaption``: the mission of an episode.
- ``HasExplanation``: an explanation of the game and the signs on the board.
- ``HasFeatureGroups``: groups of features, so that a person is asked about a group first.

``humanopts_env.testing`` tests the capabilities of a domain.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, runtime_checkable

from humanopts_env.arrays import Ints
from humanopts_env.board import Board, Image, plain_picture
from humanopts_env.domains.base import ActableDomain, Parameter, shown_values
from humanopts_env.domains.search_space import SearchSpace
import numpy as np
from numpy.typing import NDArray


@runtime_checkable
class HasBoard(Protocol):
    """A domain that can be drawn."""

    def board(self, state: Any, shown: Collection[str] | None = None) -> Board:
        """
        Return the board of a state.

        :param shown: names of the features that may be revealed; None: all.
        """


def board_of(domain: ActableDomain, state: Any, shown: Collection[str] | None = None) -> Board:
    """Return the board of a state; without ``HasBoard``, it lists the features to show."""
    if isinstance(domain, HasBoard):
        return domain.board(state, shown)
    return Board(notes=in_words(shown_values(domain, state, shown)))


@runtime_checkable
class HasPicture(Protocol):
    """A domain with a picture of each state, which may reveal every feature."""

    def picture(self, state: Any) -> Image | str | None:
        """Return an image, (H, W, 3) uint8, or a text drawing; None: there is no picture."""


@runtime_checkable
class HasCaption(Protocol):
    """A domain with episodes that differ in their missions."""

    def caption(self, state: Any) -> str:
        """Return the mission, which a person must know besides the features; empty if none."""


def caption_of(domain: ActableDomain, state: Any) -> str:
    """Return the caption of a state, on one line; empty if none."""
    return ' '.join(domain.caption(state).split()) if isinstance(domain, HasCaption) else ''


def pictured_board_of(
    domain: ActableDomain, state: Any, shown: Collection[str] | None = None
) -> Board:
    """
    Return the board of a state with its picture, if any.

    Pictures are slow to make, so only processes that draw call this.

    :param shown: as in ``board_of``; the picture ignores it.
    """
    board = board_of(domain, state, shown)
    if not isinstance(domain, HasPicture):
        return board
    try:
        picture = domain.picture(state)
    except Exception as error:  # raised by external code; the features are still shown
        picture = f'no picture: {error}'
    if picture is None or isinstance(picture, str):
        return replace(board, picture=plain_picture(picture or ''))
    return replace(board, image=picture)


def in_words(values: Mapping[str, str], drawn: Collection[str] = ()) -> tuple[str, ...]:
    """
    Return features and their values in words.

    :param drawn: names of features to omit, since they are visible on the board.
    """
    return tuple(
        f'{name.replace("_", " ")}: {value}' for name, value in values.items() if name not in drawn
    )


@runtime_checkable
class HasPlanningFeatures(Protocol):
    """
    Games with features only for planning; people are not asked about them.

    These features have few values, so that abstract states are visited often.
    """

    def planning_features(self) -> NDArray[np.integer]:
        """Return the planning features, (N, P), whole numbers from 0."""


@runtime_checkable
class HasPrimitiveColumns(Protocol):
    """A domain that defines the columns of abstract states for plans with primitive actions."""

    primitive_columns: Sequence[str]  # features with bins, as in ``PlanRequest.columns``


@runtime_checkable
class HasSearchSpace(Protocol):
    """
    A domain that defines the search space for subgoals.

    In other enumerable domains, every state is a separate cell.
    """

    def search_space(self) -> SearchSpace:
        """Return the states of the random tasks, and the cell and situation of each."""


@dataclass(frozen=True)
class TeachingDefaults:
    """The options taught by default."""

    options: tuple[str, ...] = ()  # names of reference options taught in a demo; empty: all


@runtime_checkable
class HasTeachingDefaults(Protocol):
    """A domain with its own teaching defaults."""

    teaching: TeachingDefaults


@dataclass(frozen=True)
class Baselines:
    """The baselines of plans."""

    variants: Mapping[str, Mapping[str, Parameter]] = field(default_factory=dict)
    """Changed parameters of each variant of the game to compare in, by the variant's name."""
    paper_options: tuple[str, ...] = ()  # option names of the paper's plan
    heuristic: Callable[[Any], Ints] | None = None
    """A rule written by hand: returns the action (N,) in each of N ``Games``."""


@runtime_checkable
class HasBaselines(Protocol):
    """A domain that defines the baselines of plans."""

    def baselines(self) -> Baselines:
        """Return the baselines in this variant of the game."""


@runtime_checkable
class HasActionMask(Protocol):
    """A domain that defines which actions can change the state."""

    def action_mask(self, state: Any) -> NDArray[np.int8]:
        """Return the mask, (A,): 1 for actions that can change the state."""


@dataclass(frozen=True, slots=True)
class StepEffect:
    """The effect of one step, in words."""

    text: str  # a few words without a full stop, such as "picked the passenger up"
    changed: bool = True  # False: the action itself had no effect


@runtime_checkable
class HasStepEffects(Protocol):
    """A domain that describes the effect of a step."""

    def step_effect(self, state: Any, action: int, successor: Any) -> StepEffect:
        """Return the effect of a step from ``state`` to ``successor``."""


def step_effect(domain: ActableDomain, state: Any, action: int, successor: Any) -> StepEffect:
    """Return the effect of a step; default: the name of its action."""
    if isinstance(domain, HasStepEffects):
        return domain.step_effect(state, action, successor)
    return plain_effect(domain, state, action, successor)


def plain_effect(domain: ActableDomain, state: Any, action: int, successor: Any) -> StepEffect:
    """Return the effect of a step: the name of its action, or that nothing changed."""
    if state == successor:
        return StepEffect('nothing changed', changed=False)
    return StepEffect(domain.actions[action].name)


def move_effect(asked: str, went: str, *, free: bool = False) -> StepEffect:
    """
    Return the effect of a move in a grid.

    :param asked: requested direction.
    :param went: direction of the actual move; empty: no move.
    :param free: whether the requested direction was free.
    """
    if not went:
        wall = 'slid into a wall' if free else 'wall'
        return StepEffect(f'{wall}: nothing moved', changed=False)
    return StepEffect(f'went {went}' if went == asked else f'slid {went}')


@dataclass(frozen=True, slots=True)
class FeatureGroup:
    """Features of one object."""

    words: str  # completes "anything about ...", such as the ghosts
    features: tuple[str, ...]  # names, two or more


@runtime_checkable
class HasFeatureGroups(Protocol):
    """A domain with many features: people are asked about groups of them first."""

    feature_groups: Sequence[FeatureGroup]  # each feature is in at most one group


def feature_groups(domain: ActableDomain) -> Sequence[FeatureGroup]:
    """Return the feature groups of a domain; empty if it has none."""
    return domain.feature_groups if isinstance(domain, HasFeatureGroups) else ()


@runtime_checkable
class HasExplanation(Protocol):
    """A domain that explains the game to a person."""

    # Signs on the board with their meanings. The first sign is empty; its text is the goal.
    explanation: Sequence[tuple[str, str]]


def explanation(domain: ActableDomain) -> Sequence[tuple[str, str]]:
    """Return the signs of a domain and their meanings; empty if it has no explanation."""
    return domain.explanation if isinstance(domain, HasExplanation) else ()
