"""From rows of features to the columns that a decision tree looks at."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from humanopts_env.domains.base import Domain, feature_columns, FeatureKind
from humanopts_learner.trees.tree import TreeError
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Column:
    """One tree column: an ordinal feature itself, or whether a nominal one has one value."""

    feature: str
    index: int  # column of the feature among all features of the domain
    value: int | None = None  # None: the feature itself; else 1 where it has this value

    def to_dict(self) -> dict[str, Any]:
        """Return the column as JSON data."""
        return {'feature': self.feature, 'index': self.index, 'value': self.value}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> 'Column':
        """
        Read what ``to_dict`` wrote.

        :raises TreeError: it is not a column.
        """
        try:
            name, index, value = data['feature'], data['index'], data['value']
        except (KeyError, TypeError) as error:
            raise TreeError(f'a tree column has no {error}') from None
        numbers = [index] if value is None else [index, value]
        if not isinstance(name, str) or any(type(n) is not int or n < 0 for n in numbers):
            raise TreeError(f'a tree column is not a feature, an index and a value: {data}')
        return cls(name, index, value)


def encoding(domain: Domain[Any], features: Sequence[str]) -> tuple[Column, ...]:
    """
    Return the tree columns of selected features: ordinal as they are, nominal one-hot.

    :raises DomainError: a name is not a feature of the domain.
    """
    columns: list[Column] = []
    for index in feature_columns(domain, features):
        feature = domain.features[index]
        if feature.kind is FeatureKind.ORDINAL:
            columns.append(Column(feature.name, index))
        else:
            values = range(len(feature.values))
            columns += [Column(feature.name, index, value) for value in values]
    return tuple(columns)


def encode_rows(columns: Sequence[Column], rows: NDArray[np.int32]) -> NDArray[np.float32]:
    """
    Return what the trees see.

    :param rows: (N, F), all features of the domain.
    :return: (N, C), one column after the other in memory, as large trees are walked.
    """
    picked = rows.T[[column.index for column in columns]]
    values = [column.value for column in columns]
    if any(value is not None for value in values):
        one_hot = np.array([value is not None for value in values], dtype=np.bool_)
        wanted = np.array([value or 0 for value in values], dtype=np.int32)
        picked = np.where(one_hot[:, None], picked == wanted[:, None], picked)
    return picked.astype(np.float32).T
