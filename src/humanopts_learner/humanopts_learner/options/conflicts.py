"""
Situations that the chosen features cannot distinguish, and the feature that could.

Examples with equal chosen features but different labels limit the accuracy of any policy,
initiation set or termination condition over these features.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import factorial, prod

from humanopts_env.arrays import Rows
from humanopts_env.domains.base import ActableDomain, Feature, FeatureKind
from humanopts_env.domains.formulas import FeatureColumn, plain_name, stacked
from humanopts_learner.demonstrations import Demonstration, Kind, TREES
from humanopts_learner.options.learn import Dataset, Examples, make_dataset
import numpy as np
from numpy.typing import NDArray

MAX_TEXTS = 10
NO_START = 'cannot start here'  # wording in a situation
CHANCE = 0.05  # significance level for separation by a continuous feature
SLIP = 1  # number of deviating actions in a situation that may be a slip


@dataclass(frozen=True)
class _Conflict:
    """One situation with different labels."""

    rows: Rows  # (N, F) examples with equal chosen features
    labels: NDArray[np.int64]  # (N,)
    text: str
    structural: bool  # False: possibly a slip

    def separated_by(self, index: int, feature: Feature) -> bool:
        """
        Return whether one more feature separates the labels.

        Few examples have equal values of a continuous feature, so it must separate the labels into
        ranges, with more examples than expected by chance.
        """
        if feature.kind is FeatureKind.CONTINUOUS:
            classes, counts = np.unique(self.labels, return_counts=True)
            of_class = [self.rows[self.labels == label, index] for label in classes]
            ranges = sorted((values.min(), values.max()) for values in of_class)
            apart = all(one[1] < other[0] for one, other in pairwise(ranges))
            orders = factorial(len(self.labels)) // prod(map(factorial, counts.tolist()))
            return apart and factorial(len(classes)) <= CHANCE * orders
        pairs = set(zip(self.rows[:, index].tolist(), self.labels.tolist()))
        return len(pairs) == len({value for value, _ in pairs})


def find_conflicts(data: Dataset, domain: ActableDomain) -> tuple[tuple[str, ...], str]:
    """
    Find the situations of one option with different labels.

    :return: descriptions of the situations, most frequent first; and the feature that separates
        more than half of them, ignoring slips. Empty: none.
    """
    found = [
        conflict
        for examples, words, may_slip in _parts(data)
        for conflict in _conflicts(examples, data.chosen, words, may_slip)
    ]
    found.sort(key=lambda conflict: -len(conflict.labels))
    structural = [conflict for conflict in found if conflict.structural]
    separated = {
        feature.name: sum(conflict.separated_by(index, feature) for conflict in structural)
        for index, feature in enumerate(domain.features)
        if feature.name not in data.features
    }
    best = max(separated, key=lambda name: separated[name], default='')
    suggested = best if 2 * separated.get(best, 0) > len(structural) else ''
    return tuple(conflict.text for conflict in found[:MAX_TEXTS]), suggested


@dataclass(frozen=True)
class Contradiction:
    """A situation where a demonstration differs from all earlier ones."""

    text: str
    earlier: Demonstration  # last earlier demonstration that differs
    step: int  # step of the new demonstration


def contradiction(
    newest: Demonstration, earlier: Sequence[Demonstration], domain: ActableDomain
) -> Contradiction | None:
    """
    Return the first situation where a demonstration contradicts all earlier ones.

    Ends are compared before starts (except in a "not here" answer), and starts before actions.
    With the method ``goal``, actions are not compared, because nothing is learned from them.

    :param earlier: valid demonstrations of the same option, sorted by number.
    :return: None: it agrees with an earlier demonstration in every known situation.
    """
    if not any(demo.kind is Kind.TRAJECTORY for demo in (newest, *earlier)):
        return None
    data = make_dataset([*earlier, newest], domain)
    chosen, last = data.chosen, len(earlier)
    ends, *others = _parts(data)
    starts_first = newest.kind is Kind.NOT_HERE
    for examples, words, is_action in [others[0], ends] if starts_first else [ends, *others]:
        if is_action and data.method != TREES:
            continue
        keys = list(map(tuple, stacked(chosen, examples.rows).astype(np.float32).tolist()))
        shown = list(zip(keys, examples.labels.tolist(), examples.source.tolist()))
        before = {key: (label, source) for key, label, source in shown if source < last}
        agreed = {(key, label) for key, label, source in shown if source < last}
        agreed_now = {
            key for key, label, source in shown if source == last and (key, label) in agreed
        }
        for at, (key, label, source) in enumerate(shown):
            if source < last or key not in before or key in agreed_now:
                continue
            other, number = before[key]
            row = examples.rows[at]
            demo = data.demonstrations[number]
            text = (
                f'{_situation(row, chosen)}: now {words[label]}, '
                f'in demonstration {demo.number} {words[other]}'
            )
            return Contradiction(text, demo, newest.features.index(tuple(row.tolist())))
    return None


def _parts(data: Dataset) -> Iterator[tuple[Examples, Sequence[str], bool]]:
    """Yield examples of beta, I and policy, words for labels, and whether slips are possible."""
    yield data.termination, ('not the end', 'the end'), False
    yield data.initiation, (NO_START, 'can start here'), False
    yield data.policy, data.actions, True


def _conflicts(
    examples: Examples,
    chosen: Sequence[FeatureColumn],
    words: Sequence[str],
    may_slip: bool,
) -> list[_Conflict]:
    seen = stacked(chosen, examples.rows).astype(np.float32)  # precision of the trees
    _, group = np.unique(seen, axis=0, return_inverse=True)
    pairs = np.unique(np.stack([group.ravel(), examples.labels]), axis=1)[0]
    found = []
    for number in np.flatnonzero(np.bincount(pairs) > 1):
        in_region = group.ravel() == number
        rows, labels = examples.rows[in_region], examples.labels[in_region]
        counts = Counter(labels.tolist()).most_common()
        answers = ', '.join(f'{words[label]} ({count}x)' for label, count in counts)
        text = f'{_situation(rows[0], chosen)}: {answers}'
        found.append(_Conflict(rows, labels, text, not may_slip or counts[1][1] > SLIP))
    return found


def _situation(row: Rows, chosen: Sequence[FeatureColumn]) -> str:
    return ', '.join(f'{plain_name(column.feature.name)} {column.text(row)}' for column in chosen)
