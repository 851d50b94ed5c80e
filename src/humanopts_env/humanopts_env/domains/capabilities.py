"""
Capabilities that a domain may have beside its rules; the learner and the teaching tools use them.

A domain has a capability by having the method or attribute; nothing is registered.

- ``HasBoard``: it says what is where on its board, so that it can be drawn.
- ``HasBatchGames``: it plays many games at once, so that plans can be made from samples.
  ``DrawsAhead``: their chance can be drawn before they are played.
- ``HasSearchSpace``: it defines where subgoals of automatic options are searched for.
- ``HasTeachingDefaults``: it names the options to teach.
- ``HasBaselines``: it names the baselines of plans, and the variants of the game to compare in.
- ``HasActionMask``: it tells which actions can change something, where states cannot be listed.
- ``HasStepEffects``: it tells in words what a step did.
- ``HasExplanation``: it explains the game and the signs on the board.
- ``HasFeatureGroups``: it groups its features, so that a person is asked about a group first.

``humanopts_env.contract`` tests each of them in every domain that has it.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

from humanopts_env.arrays import Flags, Ints, Rows
from humanopts_env.board import Board
from humanopts_env.domains.base import Domain, Parameter, shown_values
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


def board_of(domain: Domain[Any], state: Any, shown: Collection[str] | None = None) -> Board:
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


@dataclass(frozen=True)
class Abstraction:
    """The P abstract features of a state abstraction, named by their indices."""

    sizes: tuple[int, ...]  # number of values of each
    context: tuple[int, ...] = ()  # indices of features that hardly decide which option is better
    mixture: tuple[int, ...] = ()  # indices of those also used in plans with both


class BatchGames(Protocol):
    """
    Many games of one domain at once. A batch is an object of any type: N games that step in place.

    Planning sees games through a state abstraction: games with equal abstract features are in one
    abstract state, and these are few enough that each is visited often. Primitive actions need a
    finer abstraction than options, which have policies of their own.
    """

    domain: Domain[Any]  # that the games are of

    def batch_reset(self, count: int, rng: np.random.Generator) -> Any:
        """Begin games."""

    def batch_of(self, states: Sequence[Any]) -> Any:
        """Return games that stand at given states."""

    def batch_states(self, batch: Any) -> list[Any]:
        """Return the state of each game."""

    def batch_take(self, batch: Any, games: Ints) -> Any:
        """Return copies of chosen games, by their indices (M,)."""

    def batch_put(self, batch: Any, games: Ints, source: Any) -> None:
        """Set chosen games, by their indices (M,), each once, to the M games of another batch."""

    def batch_step(self, batch: Any, actions: Ints, rng: np.random.Generator) -> NDArray[Any]:
        """Take one step in every game that is not over, in place; return the rewards (N,)."""

    def batch_step_each(
        self, batch: Any, actions: Ints, rngs: Sequence[np.random.Generator]
    ) -> NDArray[Any]:
        """
        Take the step of ``Domain.step`` in every game, in place; return the rewards (N,).

        :param batch: games that are not over.
        :param rngs: (N,) the chance of each game, drawn from as ``Domain.step`` does.
        """

    def batch_over(self, batch: Any) -> Flags:
        """Return (N,): whether each game is over."""

    def batch_features(self, batch: Any) -> Rows:
        """Return (N, F): all features."""

    def batch_outcome(self, batch: Any) -> Mapping[str, NDArray[Any]]:
        """Return the measures that are reported beside the return, each (N,), by name."""

    def abstraction(self, *, fine: bool) -> Abstraction:
        """
        Return the abstract features.

        :param fine: True: the features that primitive actions need; False: those that options
            need. Only the latter may have a ``mixture``.
        """

    def abstract_features(self, batch: Any, rows: Rows, *, fine: bool) -> NDArray[np.int32]:
        """
        Return (N, P): the values of the abstract features, from 0.

        :param rows: (N, F) features of the games.
        """


@runtime_checkable
class HasBatchGames(Protocol):
    """A domain that plays many games at once."""

    def batch_games(self) -> BatchGames:
        """Return the object that plays them."""


@runtime_checkable
class DrawsAhead(Protocol):
    """
    ``BatchGames`` whose chance does not depend on states, so that it can be drawn ahead.

    Games that are compared with the same chance then draw it once.
    """

    def draws_ahead(self, rng: np.random.Generator, steps: int) -> NDArray[Any]:
        """Return (steps, D): what one game draws in so many steps of ``Domain.step``."""

    def batch_step_drawn(self, batch: Any, actions: Ints, draws: NDArray[Any]) -> NDArray[Any]:
        """
        Take the step of ``Domain.step`` in every game, in place; return the rewards (N,).

        :param batch: games that are not over.
        :param draws: (N, D) the chance of this step.
        """


def feature_rows(domain: Domain[Any], states: Sequence[Any]) -> Rows:
    """Return the features of N states, (N, F), all at once where the domain can."""
    if isinstance(domain, HasBatchGames):
        games = domain.batch_games()
        return games.batch_features(games.batch_of(states))
    values = [domain.feature_values(state) for state in states]
    return np.array(values, dtype=np.float64).reshape(len(states), len(domain.features))


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
class PlanSettings:
    """How to plan from samples; found by hand, on other seeds than those of reported results."""

    gamma: float  # discount per primitive step
    sampling: Mapping[str, Any]  # numbers by the names of the learner's ``Sampling``


@dataclass(frozen=True)
class Scores:
    """The results of N games."""

    total: NDArray[Any]  # (N,) undiscounted return
    outcomes: Mapping[str, NDArray[Any]]  # (N,) each, as ``BatchGames.batch_outcome``


class Heuristic(Protocol):
    """A rule written by hand that chooses among the reference options."""

    def __call__(self, games: int, seed: int, /) -> Scores:
        """Play games until they are over or cut off, with a choice at every step."""


@dataclass(frozen=True)
class Baselines:
    """The baselines that plans are compared with."""

    variants: Mapping[str, Mapping[str, Parameter]] = field(default_factory=dict)
    """Changed parameters of each variant of the game to compare in, by the variant's name."""
    paper_options: tuple[str, ...] = ()  # names, for a plan with these options alone
    primitive: PlanSettings | None = None  # for plans with primitive actions
    interrupted: PlanSettings | None = None  # for plans with options that are interrupted
    heuristic: Heuristic | None = None


@runtime_checkable
class HasBaselines(Protocol):
    """A domain that names the baselines of plans."""

    def baselines(self) -> Baselines:
        """Return the baselines in this variant of the game."""


@runtime_checkable
class HasActionMask(Protocol):
    """A domain that tells which actions can change something."""

    def action_mask(self, state: Any) -> NDArray[np.int8]:
        """Return (A,): 1 for those that can."""


@dataclass(frozen=True, slots=True)
class StepEffect:
    """What one step did, for the person who watches."""

    text: str  # a few words without a full stop, such as "picked the passenger up"
    changed: bool = True  # False: it had no effect, as far as the person's action goes


@runtime_checkable
class HasStepEffects(Protocol):
    """A domain that tells in words what a step did."""

    def step_effect(self, state: Any, action: int, successor: Any) -> StepEffect:
        """Return what a step from ``state`` did that led to ``successor``."""


def step_effect(domain: Domain[Any], state: Any, action: int, successor: Any) -> StepEffect:
    """Return what a step did; the name of its action where the domain has no words for it."""
    if isinstance(domain, HasStepEffects):
        return domain.step_effect(state, action, successor)
    return plain_effect(domain, state, action, successor)


def plain_effect(domain: Domain[Any], state: Any, action: int, successor: Any) -> StepEffect:
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
    """A domain with so many features that a person is asked about groups of them first."""

    feature_groups: Sequence[FeatureGroup]  # a feature is in one group at most


def feature_groups(domain: Domain[Any]) -> Sequence[FeatureGroup]:
    """Return the groups of a domain's features; empty where it has none."""
    return domain.feature_groups if isinstance(domain, HasFeatureGroups) else ()


@runtime_checkable
class HasExplanation(Protocol):
    """A domain that explains the game to a person."""

    # Signs on the board, each with its meaning; the first sign is empty: what to do.
    explanation: Sequence[tuple[str, str]]


def explanation(domain: Domain[Any]) -> Sequence[tuple[str, str]]:
    """Return the signs of a domain and their meanings; empty where it has no words for them."""
    return domain.explanation if isinstance(domain, HasExplanation) else ()
