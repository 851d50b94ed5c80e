"""Features on which the choice between options depends, as far as demonstrations show it."""

from collections.abc import Mapping, Sequence

from humanopts_env.arrays import Flags, Floats
from humanopts_env.domains.base import ActableDomain, FeatureKind
from humanopts_learner.demonstrations import Demonstration, Kind
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_learner.planning.abstraction import BINS
import numpy as np

MIN_STARTS = 3  # minimum number of starts for, and against, an option
MIN_SHARE = 0.9  # minimum share of correctly classified starts, balanced


def suggest_column(
    domain: ActableDomain,
    options: Sequence[LearnedOption],
    demonstrations: Mapping[str, Sequence[Demonstration]],
) -> str:
    """
    Return the feature that best separates the starts of options where several could start.

    A demonstrated start counts for its option. A "not here" answer counts against it, and so does
    the start of another option where this one could start, too. Symbols of the options do not show
    such a difference, so a plan needs the feature as a column. A continuous feature has ``BINS``
    bins, one of which begins at the best split; planning finds where exactly the choice changes.

    :param demonstrations: demonstrations of each option, by name.
    :return: a column as in ``Abstraction``, such as ``battery:2,12,22,32``; empty: no feature
        separates them.
    """
    starts = [
        (name, demo.kind is Kind.TRAJECTORY, demo.feature_rows[0])
        for name, demos in demonstrations.items()
        for demo in demos
    ]
    best, found = 0.0, ''
    for option in options if len(options) > 1 else ():
        own = [row for name, shown, row in starts if name == option.name and shown]
        others = [row for name, shown, row in starts if (name == option.name) != shown]
        rows = np.array([*own, *others]).reshape(-1, len(domain.features))
        rows, is_own = rows[can := option.can_start(rows)], (np.arange(len(rows)) < len(own))[can]
        if min(is_own.sum(), (~is_own).sum()) < MIN_STARTS:
            continue
        for index, feature in enumerate(domain.features):
            share, edge = _best_split(rows[:, index], is_own, feature.kind)
            if share > max(best, MIN_SHARE - 1e-9):
                best, found = share, feature.name
                if feature.kind is FeatureKind.ORDINAL:
                    found += f':{edge:g}'
                elif feature.kind is FeatureKind.CONTINUOUS:
                    width = feature.span / BINS
                    first = feature.low + (edge - feature.low) % width
                    edges = np.arange(first, feature.high, width)
                    found += f':{",".join(f"{each:g}" for each in edges if each > feature.low)}'
    return found


def _best_split(values: Floats, own: Flags, kind: FeatureKind) -> tuple[float, float]:
    """
    Find the best split of starts (N,) by one feature.

    :param own: (N,) whether each start counts for the option.
    :return: the share classified correctly, mean of both classes; and the edge between the lower
        and the upper part, 0 if the feature is nominal.
    """
    known = np.unique(values)
    here = values == known[:, None]  # (V, N)
    rates = np.stack([here[:, own].mean(axis=1), here[:, ~own].mean(axis=1)])  # (2, V)
    if kind is FeatureKind.NOMINAL:
        return float(rates.max(axis=0).sum() / 2), 0.0
    if len(known) == 1:
        return 0.5, 0.0
    below = rates.cumsum(axis=1)[:, :-1]
    shares = 0.5 + np.abs(below[0] - below[1]) / 2
    best = int(shares.argmax())
    return float(shares[best]), float(known[best] + known[best + 1]) / 2
