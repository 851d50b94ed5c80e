"""
Situations that the chosen features cannot separate, and the feature that could.

Examples that are alike in the chosen features but carry different labels put a bound on what any
policy, initiation set or termination condition over these features can learn.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from humanopts_env.arrays import Rows
from humanopts_env.domains.base import Domain
from humanopts_learner.options.learn import Dataset, Examples
import numpy as np
from numpy.typing import NDArray

MOST_TEXTS = 10
NO_START = 'cannot start here'  # in the words of a situation
SLIP = 1  # so many different actions in a situation may be a slip of the hand


@dataclass(frozen=True)
class Conflicts:
    """The situations with different labels, and a feature that would separate them."""

    texts: tuple[str, ...]  # in words, the most frequent first
    suggested_feature: str | None  # not chosen; separates most of the situations


@dataclass(frozen=True)
class _Conflict:
    """One situation with different labels."""

    rows: Rows  # (N, F) its examples, alike in the chosen features
    labels: NDArray[np.int64]  # (N,)
    text: str
    structural: bool  # False: it may be a slip

    def separated_by(self, index: int) -> bool:
        """Return whether examples that are alike in one more feature have equal labels."""
        pairs = set(zip(self.rows[:, index].tolist(), self.labels.tolist()))
        return len(pairs) == len({value for value, _ in pairs})


def find_conflicts(data: Dataset, domain: Domain[Any]) -> Conflicts:
    """
    Find the situations of one option that carry different labels.

    A feature is suggested when it separates more than half of the situations, without slips.
    """
    chosen = sorted({encoded.index for encoded in data.encoding})
    actions = [action.name for action in domain.actions]
    parts: list[tuple[Examples, Callable[[int], str], bool]] = [
        (data.termination, lambda label: ('not the end', 'the end')[label], False),
        (data.initiation, lambda label: (NO_START, 'can start here')[label], False),
        (data.policy, lambda label: actions[label], True),
    ]
    found = [
        conflict
        for examples, word, may_slip in parts
        for conflict in _conflicts(examples, chosen, domain, word, may_slip)
    ]
    found.sort(key=lambda conflict: -len(conflict.labels))
    structural = [conflict for conflict in found if conflict.structural]
    others = [index for index in range(len(domain.features)) if index not in chosen]
    separated = {i: sum(conflict.separated_by(i) for conflict in structural) for i in others}
    best = max(separated, key=lambda index: separated[index], default=None)
    suggested = None
    if best is not None and 2 * separated[best] > len(structural):
        suggested = domain.features[best].name
    return Conflicts(tuple(conflict.text for conflict in found[:MOST_TEXTS]), suggested)


def _conflicts(
    examples: Examples,
    chosen: Sequence[int],
    domain: Domain[Any],
    word: Callable[[int], str],
    may_slip: bool,
) -> list[_Conflict]:
    _, group = np.unique(examples.rows[:, chosen], axis=0, return_inverse=True)
    pairs = np.unique(np.stack([group.ravel(), examples.labels]), axis=1)[0]
    found = []
    for number in np.flatnonzero(np.bincount(pairs) > 1):
        alike = group.ravel() == number
        rows, labels = examples.rows[alike], examples.labels[alike]
        counts = Counter(labels.tolist()).most_common()
        answers = ', '.join(f'{word(label)} ({count}x)' for label, count in counts)
        text = f'{_situation(rows[0], chosen, domain)}: {answers}'
        found.append(_Conflict(rows, labels, text, not may_slip or counts[1][1] > SLIP))
    return found


def _situation(row: Rows, chosen: Sequence[int], domain: Domain[Any]) -> str:
    features = [domain.features[index] for index in chosen]
    return ', '.join(
        f'{feature.name.replace("_", " ")} {feature.values[row[index]]}'
        for index, feature in zip(chosen, features)
    )
