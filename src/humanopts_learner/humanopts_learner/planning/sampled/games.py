"""What sampled planning sees of many games: their features and their abstract states."""

from dataclasses import dataclass
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.capabilities import BatchGames, HasBatchGames
from humanopts_learner.planning.action_sets import OPTIONS_ONLY, PRIMITIVE
from humanopts_learner.planning.errors import NotEnumerableError, PlanError
import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.intp]
Flags = NDArray[np.bool_]
LARGEST_CODE = 2**53  # abstract states are numbered below this


def batch_games(domain: Domain[Any]) -> BatchGames:
    """
    Return what plays many games of a domain.

    :raises NotEnumerableError: nothing does, so it can be planned in neither way.
    """
    if isinstance(domain, HasBatchGames):
        return domain.batch_games()
    raise NotEnumerableError(
        f'the states of {domain.name} cannot all be listed, so it has no exact models; and it has '
        'no method batch_games, so it has no sampled ones'
    )


@dataclass(frozen=True)
class View:
    """What is seen of N games before they step again."""

    batch: Any
    rows: NDArray[np.int32]  # (N, F)
    codes: NDArray[np.int64]  # (N,) numbers of the abstract states
    games: BatchGames

    def take(self, chosen: Ints) -> 'View':
        """Return what is seen of chosen games (M,)."""
        batch = self.games.batch_take(self.batch, chosen)
        return View(batch, self.rows[chosen], self.codes[chosen], self.games)


class Watcher:
    """Looks at batches."""

    def __init__(self, games: BatchGames, *, fine: bool, beside: tuple[int, ...] = ()) -> None:
        """
        Prepare for one action set; ``watcher_for`` knows what it needs.

        :param beside: columns of what is not fine that are seen before the fine ones.
        :raises PlanError: the abstract features have too many values.
        """
        self.games, self.fine, self.beside = games, fine, beside
        coarse = games.abstraction(fine=False).sizes if beside else ()
        sizes = (*(coarse[column] for column in beside), *games.abstraction(fine=fine).sizes)
        if np.prod(sizes, dtype=np.float64) > LARGEST_CODE:
            raise PlanError(f'abstract features of {sizes} values are too fine')
        self._sizes, self._radix = sizes, np.cumprod([1, *sizes[:-1]], dtype=np.int64)

    def __call__(self, batch: Any) -> View:
        """Return what is seen of a batch."""
        rows = self.games.batch_features(batch)
        features = self.games.abstract_features(batch, rows, fine=self.fine)
        if self.beside:
            coarse = self.games.abstract_features(batch, rows, fine=False)
            features = np.concatenate([coarse[:, list(self.beside)], features], axis=1)
        return View(batch, rows, features @ self._radix, self.games)

    @property
    def context(self) -> tuple[int, ...]:
        """Columns of the abstract features of context; all that are seen beside the fine ones."""
        if self.beside:
            return tuple(range(len(self.beside)))
        return self.games.abstraction(fine=self.fine).context

    def without_context(self, codes: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the codes (N,) of abstract states as if features of context were all 0."""
        for column in self.context:
            radix = self._radix[column]
            codes = codes - codes // radix % self._sizes[column] * radix
        return codes


def watcher_for(games: BatchGames, action_set: str) -> Watcher:
    """
    Return what looks at batches for an action set.

    Plans with options and primitive actions see what both need. Without what the options are told,
    states that look alike would hide where progress is made, and primitive actions, valued step by
    step, would wander among them.

    :raises PlanError: the abstract features have too many values.
    """
    beside: tuple[int, ...] = ()
    if action_set not in (*OPTIONS_ONLY, PRIMITIVE):
        beside = games.abstraction(fine=False).mixture
    return Watcher(games, fine=action_set not in OPTIONS_ONLY, beside=beside)
