"""What sampled planning needs of a domain: many games at once, and discrete planning states."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from humanopts_env.domains.base import Domain
from humanopts_env.domains.pacman.domain import PacMan
from humanopts_learner.planning.action_sets import OPTIONS_ONLY, PRIMITIVE
from humanopts_learner.planning.errors import NotEnumerableError, PlanError
from humanopts_learner.planning.sampled.pacman import PacManGames
import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.intp]
Flags = NDArray[np.bool_]
LARGEST_CODE = 2**53  # planning states are numbered below this


class BatchDomain(Protocol):
    """
    Many games of one domain at once; a batch is whatever it likes, N games that step in place.

    Planning features tell states apart in planning, coarsely enough that each is visited often.
    Primitive actions need finer ones than options, which know their way.
    """

    @property
    def domain(self) -> Domain[Any]:
        """The domain that the games are of."""
        ...

    def batch_reset(self, count: int, rng: np.random.Generator) -> Any:
        """Begin games."""
        ...

    def batch_of(self, states: Sequence[Any]) -> Any:
        """Return games that stand at given states."""
        ...

    def batch_take(self, batch: Any, games: Ints) -> Any:
        """Return copies of chosen games, by their indices (M,)."""
        ...

    def batch_put(self, batch: Any, games: Ints, source: Any) -> None:
        """Set chosen games, by their indices (M,), each once, to the M games of another batch."""
        ...

    def batch_step(self, batch: Any, actions: Ints, rng: np.random.Generator) -> NDArray[Any]:
        """Take one step in every game that is not over, in place; return the rewards (N,)."""
        ...

    def batch_over(self, batch: Any) -> Flags:
        """Return (N,): whether each game is over."""
        ...

    def batch_features(self, batch: Any) -> NDArray[np.int32]:
        """Return (N, F): all features."""
        ...

    def batch_outcome(self, batch: Any) -> Mapping[str, NDArray[Any]]:
        """Return what is told of games beside their return, each (N,), by its name."""
        ...

    def planning_sizes(self, *, fine: bool) -> tuple[int, ...]:
        """Return how many values each planning feature has, (P,)."""
        ...

    def planning_features(
        self, batch: Any, rows: NDArray[np.int32], *, fine: bool
    ) -> NDArray[np.int32]:
        """
        Return (N, P): the values, from 0.

        :param rows: (N, F) features of the games.
        :param fine: what primitive actions need.
        """
        ...


@runtime_checkable
class HasGames(Protocol):
    """A domain that brings its own batched form."""

    def batch_domain(self) -> BatchDomain:
        """Return it."""
        ...


@runtime_checkable
class HasContext(Protocol):
    """A batched domain some of whose planning features hardly decide which option is better."""

    def planning_context(self, *, fine: bool) -> tuple[int, ...]:
        """Return the columns of these planning features."""
        ...


@runtime_checkable
class HasMixture(Protocol):
    """A batched domain whose options are told what primitive actions are not."""

    def planning_mixture(self) -> tuple[int, ...]:
        """Return the columns of the options' planning features that plans with both get too."""
        ...


def batch_domain(domain: Domain[Any]) -> BatchDomain:
    """
    Return the batched form of a domain.

    :raises NotEnumerableError: it has none, so it can be planned in neither way.
    """
    if isinstance(domain, HasGames):
        return domain.batch_domain()
    if isinstance(domain, PacMan):
        return PacManGames(domain)
    raise NotEnumerableError(
        f'the states of {domain.name} cannot all be listed, so it has no exact models; and it has '
        'no method batch_domain, so it has no sampled ones'
    )


@dataclass(frozen=True)
class View:
    """What is seen of N games before they step again."""

    batch: Any
    rows: NDArray[np.int32]  # (N, F)
    codes: NDArray[np.int64]  # (N,) numbers of the planning states
    games: BatchDomain

    def take(self, chosen: Ints) -> 'View':
        """Return what is seen of chosen games (M,)."""
        batch = self.games.batch_take(self.batch, chosen)
        return View(batch, self.rows[chosen], self.codes[chosen], self.games)


class Watcher:
    """Looks at batches."""

    def __init__(self, games: BatchDomain, *, fine: bool, beside: tuple[int, ...] = ()) -> None:
        """
        Prepare for one action set; ``watcher_for`` knows what it needs.

        :param beside: columns of what is not fine that are seen before the fine ones.
        :raises PlanError: the planning features have too many values.
        """
        self.games, self.fine, self.beside = games, fine, beside
        coarse = games.planning_sizes(fine=False) if beside else ()
        sizes = (*(coarse[column] for column in beside), *games.planning_sizes(fine=fine))
        if np.prod(sizes, dtype=np.float64) > LARGEST_CODE:
            raise PlanError(f'planning features of {sizes} values are too fine')
        self._sizes, self._radix = sizes, np.cumprod([1, *sizes[:-1]], dtype=np.int64)

    def __call__(self, batch: Any) -> View:
        """Return what is seen of a batch."""
        rows = self.games.batch_features(batch)
        features = self.games.planning_features(batch, rows, fine=self.fine)
        if self.beside:
            coarse = self.games.planning_features(batch, rows, fine=False)
            features = np.concatenate([coarse[:, list(self.beside)], features], axis=1)
        return View(batch, rows, features @ self._radix, self.games)

    @property
    def context(self) -> tuple[int, ...]:
        """Columns of the planning features of context; all that are seen beside the fine ones."""
        if self.beside:
            return tuple(range(len(self.beside)))
        if isinstance(self.games, HasContext):
            return self.games.planning_context(fine=self.fine)
        return ()

    def without_context(self, codes: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the codes (N,) of planning states as if features of context were all 0."""
        for column in self.context:
            radix = self._radix[column]
            codes = codes - codes // radix % self._sizes[column] * radix
        return codes


def watcher_for(games: BatchDomain, action_set: str) -> Watcher:
    """
    Return what looks at batches for an action set.

    Plans with options and primitive actions see what both need. Without what the options are told,
    states that look alike would hide where progress is made, and primitive actions, valued step by
    step, would wander among them.

    :raises PlanError: the planning features have too many values.
    """
    beside: tuple[int, ...] = ()
    if action_set not in (*OPTIONS_ONLY, PRIMITIVE) and isinstance(games, HasMixture):
        beside = games.planning_mixture()
    return Watcher(games, fine=action_set not in OPTIONS_ONLY, beside=beside)
