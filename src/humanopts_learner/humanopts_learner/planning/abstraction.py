"""
Abstract states: games with equal columns are in one abstract state.

Symbol columns are the decisions of options: whether each can start, whether it would end, and its
action. The preconditions and effects of options are the symbols that planning requires
(Konidaris, Kaelbling and Lozano-Perez 2018), and exist in every domain. Feature columns are named
features with bins, or the planning features of the domain.
"""

from collections.abc import Sequence
from functools import cache

from humanopts_env.arrays import Flags, Ints, Rows
from humanopts_env.domains.base import ActableDomain, DomainError, FeatureKind
from humanopts_env.domains.capabilities import HasPlanningFeatures
from humanopts_env.domains.formulas import feature_columns
from humanopts_env.games import Games, TableGames
from humanopts_env.seeding import generator
from humanopts_learner.planning.request import PlanError
import numpy as np
from numpy.typing import NDArray

Codes = NDArray[np.int64]  # of abstract states
BINS = 10  # bins of a continuous feature without numbers


class Column:
    """
    A feature column, from a text such as ``food_distance:2,4,8`` or ``legal_moves``.

    Bin k contains values from the k-th number to below the next. Without numbers, every value has
    its own bin; a continuous feature has ``BINS`` of equal width.

    :raises PlanError: the feature is unknown, or its numbers are not valid bin edges.
    """

    def __init__(self, text: str, domain: ActableDomain) -> None:
        name, _, numbers = text.partition(':')
        try:
            self._column = feature_columns(domain, [name])[0]
            self.edges = np.array([float(number) for number in numbers.split(',') if numbers])
        except (DomainError, ValueError) as error:
            raise PlanError(f'column {text!r}: {error}') from error
        if not (np.isfinite(self.edges).all() and (np.diff(self.edges) > 0).all()):
            raise PlanError(f'column {text!r}: its numbers do not ascend')
        feature = self._column.feature
        if feature.kind is FeatureKind.CONTINUOUS and not self.edges.size:
            self.edges = np.linspace(feature.low, feature.high, BINS + 1)[1:-1]

    def bins(self, rows: Rows) -> Ints:
        """Return (N,): the bin of each row (N, F)."""
        values = self._column.values(rows)
        if self.edges.size:
            return self.edges.searchsorted(values, side='right')
        return values.astype(np.intp)


class Abstraction:
    """Maps games to abstract states."""

    def __init__(self, domain: ActableDomain, columns: Sequence[str] = ()) -> None:
        """
        Select the feature columns.

        :param columns: texts as in ``Column``; empty: the domain's planning features, or its
            states if they can all be listed; without symbols either, all features.
        :raises PlanError: a column is invalid.
        """
        self._domain = domain
        self._columns = [Column(text, domain) for text in columns]

    def codes(self, games: Games | None, rows: Rows, symbols: Sequence[Ints | Flags]) -> Codes:
        """
        Return (N,): the codes of the abstract states of games.

        A code is the sum of all columns, each multiplied by a random 64-bit number, so a collision
        among a million states has a probability below 1e-6.

        :param games: games of the rows; None: only their features are known.
        :param rows: (N, F) features of the games.
        :param symbols: symbol columns, (N,) each.
        """
        columns = list(symbols)
        if self._columns:
            pass
        elif isinstance(games, HasPlanningFeatures):
            columns += list(games.planning_features().T)
        elif isinstance(games, TableGames):
            columns.append(games.state)
        elif not symbols:
            self._columns = [Column(each.name, self._domain) for each in self._domain.features]
        columns += [column.bins(rows) for column in self._columns]
        total = np.zeros(len(rows), dtype=np.uint64)
        for column, weight in zip(columns, _weights(len(columns)), strict=True):
            total += column.astype(np.uint64) * weight
        return total.view(np.int64)


class StateRows:
    """
    The rows of abstract states in a table.

    Codes are random numbers, so their leading bits place them in equally filled buckets. Searching
    a bucket is several times as fast as a binary search.
    """

    def __init__(self, states: Codes) -> None:
        """Index the codes of K states."""
        self._order = np.append(np.argsort(states), -1)
        self._states = np.append(states, np.iinfo(np.int64).max)[self._order]
        self._bits = len(states).bit_length() + 1
        sizes = np.bincount(self._bucket(self._states[:-1]), minlength=1 << self._bits)
        self._begins, self._largest = np.cumsum(sizes) - sizes, int(sizes.max())

    def __call__(self, states: Codes) -> Ints:
        """Return the row of each state (N,); -1: not in the table."""
        at: Ints = self._begins.take(self._bucket(states))
        for _ in range(self._largest):
            at += self._states.take(at) < states
        return np.where(self._states.take(at) == states, self._order.take(at), -1)

    def _bucket(self, states: Codes) -> Ints:
        return (states >> 64 - self._bits) + (1 << self._bits - 1)


@cache
def _weights(count: int) -> NDArray[np.uint64]:
    """Return one odd number per column, the same in every process."""
    rng = generator(0, 'abstraction')
    return rng.integers(2**64, size=count, dtype=np.uint64) | np.uint64(1)
