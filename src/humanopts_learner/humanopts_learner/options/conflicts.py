"""
Situations that the chosen features cannot distinguish, and advice on the features to choose.

Examples with equal chosen features but different labels limit the accuracy of any policy,
initiation set or termination condition over these features. Among many features, some separate
such examples by chance. So a feature is suggested only if it explains more than it would with
shuffled labels (a permutation test; Fisher 1935), at a level that holds for all features together
(Bonferroni). Features that separate ends come first, since an option with a wrong end is useless;
then those that separate starts, and actions.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from humanopts_env.arrays import Flags, Ints, Rows
from humanopts_env.domains.base import ActableDomain, FeatureKind
from humanopts_env.domains.formulas import feature_columns, FeatureColumn, plain_name, stacked
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import Demonstration, GOAL, Kind, TREES
from humanopts_learner.intervals import Interval, LEVEL
from humanopts_learner.options.decision_tree import encode_rows, fit_tree, Tree
from humanopts_learner.options.learn import Dataset, Examples, make_dataset
from humanopts_learner.options.learned_option import LearnedOption, MEMBER
import numpy as np

MAX_TEXTS = 10
SHUFFLES = 2000  # minimum number of shuffles in a permutation test
TRIED = 5  # maximum number of features tested; those that explain the most come first
TENTHS = 10  # number of intervals of a continuous feature; values in one count as equal
MIN_SHOWN = 2  # minimum number of demonstrations for advice about ends
MIN_UNUSED = 10  # minimum number of demonstrations to call a chosen feature needless
WORSE = 0.25  # maximum share of demonstrations in which the option does worse without it
UNTOLD = 'No chosen feature tells where the option ends: choose one that changes there.'
SAY_AGAIN = 'If the option can start where it ends, say so before you say done.'


def find_conflicts(data: Dataset) -> tuple[str, ...]:
    """Return the situations of one option with different labels, most frequent first."""
    found = [
        conflict
        for examples, words in _parts(data)
        for conflict in _conflicts(examples, data.chosen, words)
    ]
    found.sort(key=lambda conflict: -conflict[0])
    return tuple(text for _, text in found[:MAX_TEXTS])


def advise(data: Dataset, domain: ActableDomain) -> tuple[str, ...]:
    """Return advice on features that may be missing, the most important first."""
    left = feature_columns(
        domain, {feature.name for feature in domain.features}.difference(data.features)
    )
    rng = generator(0, 'advice', data.demonstrations[0].option_name)
    advice = list[str]()
    demos = data.trajectories
    whole = Examples.of((demo.feature_rows, [0] * len(demo.actions) + [MEMBER]) for demo in demos)
    looks = _looks(whole.rows, data.chosen)
    ends = whole.labels == MEMBER
    not_over = [not demo.terminated for demo in demos]  # ends where the option could start again
    first = np.append(True, ends[:-1])
    like_any, like_passed = (np.isin(looks[ends], looks[rows]) for rows in (~ends, ~ends & ~first))
    shown = len(demos) >= MIN_SHOWN
    alike = shown and 2 * like_any.sum() > len(demos)
    if missing := _missing(whole, data.chosen, left, rng, whole.source, first):
        advice.append(f'Add "{plain_name(missing)}": it tells where the option ends.')
    elif alike and like_passed.any():
        advice.append(UNTOLD)
    else:
        _, (starts, _), (actions, _) = _parts(data)
        for examples, what in ((starts, 'where the option can start'), (actions, 'what you do')):
            units = _one_per_demonstration(examples, data.chosen)
            if missing := _missing(units, data.chosen, left, rng):
                advice.append(f'Add "{plain_name(missing)}": it tells {what}.')
                break
    like_starts = shown and 2 * like_any[not_over].sum() > sum(not_over)
    if like_starts and not any(demo.can_start_at_end for demo in demos):
        advice.append(SAY_AGAIN)
    return tuple(advice)


def find_needless(
    held_out: Sequence[LearnedOption], data: Dataset, folds: Ints, domain: ActableDomain
) -> tuple[str, ...]:
    """
    Return advice on the least used chosen feature, if the option does not need it.

    I and beta must not use it. Policies are relearned without it, and tested on the demonstrations
    that they were not learned from. It is needless if the share of those in which they do worse
    has a small upper limit.

    :param held_out: options learned without each fold.
    :param folds: (D,) fold of each demonstration.
    """
    if data.method != TREES or len(data.chosen) < 2 or len(data.trajectories) < MIN_UNUSED:
        return ()

    def used(parts: Iterable[Tree]) -> list[str]:
        return [data.encoding[at].feature for tree in parts for at in tree.tested.tolist()]

    needed = {*used(tree for o in held_out for tree in (o.initiation, o.termination))}
    if not (left := [name for name in data.features if name not in needed]):
        return ()
    times = Counter(used(option.policy for option in held_out))
    least = min(left, key=lambda name: times[name])
    encoding = [each for each in data.encoding if each.feature != least]
    rows, labels = data.policy.rows, data.policy.labels
    X, of_row = encode_rows(encoding, rows), folds[data.policy.source]
    worse = np.zeros(len(folds), dtype=np.intp)  # additional errors without the feature
    for fold, option in enumerate(held_out):
        out = of_row == fold
        without = fit_tree(
            X[~out], labels[~out], range(len(data.actions)), 0, min_leaf=data.min_leaf
        )
        wrong, wrong_with = (
            found != labels[out]
            for found in (without.most_probable(X[out]), option.action(rows[out]))
        )
        np.add.at(worse, data.policy.source[out], wrong.astype(np.intp) - wrong_with)
    shown = [demo.kind is Kind.TRAJECTORY for demo in data.demonstrations]
    if Interval.of_share(worse[shown] > 0).high > WORSE:
        return ()
    return (
        f'"{plain_name(least)}" seems unnecessary: without it, just as much is learned from your '
        f'{len(data.trajectories)} demonstrations.',
    )


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
    :return: None: the newest agrees with an earlier demonstration in every known situation.
    """
    if not any(demo.kind is Kind.TRAJECTORY for demo in (newest, *earlier)):
        return None
    data = make_dataset([*earlier, newest], domain)
    chosen, last = data.chosen, len(earlier)
    ends, *others = _parts(data)
    starts_first = newest.kind is Kind.NOT_HERE
    for examples, words in [others[0], ends] if starts_first else [ends, *others]:
        if words is data.actions and data.method == GOAL:
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
                f'but {words[other]} in demonstration {demo.number}'
            )
            return Contradiction(text, demo, newest.features.index(tuple(row.tolist())))
    return None


def _parts(data: Dataset) -> Iterator[tuple[Examples, Sequence[str]]]:
    """
    Yield examples of beta, I and policy, with words for the labels.

    Only "not here" answers are negative examples of I, not the ends of demonstrations.
    """
    yield data.termination, ('not the end', 'the end')
    labelled = []
    for demo in data.demonstrations:
        members = len(demo.actions) + (demo.can_start_at_end and not demo.terminated)
        said = members or len(demo.states)
        labelled.append((demo.feature_rows[:said], [int(members > 0)] * said))
    yield Examples.of(labelled), ('cannot start here', 'can start here')
    yield data.policy, data.actions


def _conflicts(
    examples: Examples, chosen: Sequence[FeatureColumn], words: Sequence[str]
) -> Iterator[tuple[int, str]]:
    """Yield situations with different labels, each as a number of examples and a text."""
    looks = _looks(examples.rows, chosen)
    pairs = np.unique(np.stack([looks, examples.labels]), axis=1)[0]
    for number in np.flatnonzero(np.bincount(pairs) > 1):
        at = np.flatnonzero(looks == number)
        counts = Counter(examples.labels[at].tolist()).most_common()
        answers = ', '.join(f'{words[label]} ({count}x)' for label, count in counts)
        yield len(at), f'{_situation(examples.rows[at[0]], chosen)}: {answers}'


def _situation(row: Rows, chosen: Sequence[FeatureColumn]) -> str:
    return ', '.join(f'{plain_name(column.feature.name)} {column.text(row)}' for column in chosen)


def _looks(rows: Rows, chosen: Sequence[FeatureColumn]) -> Ints:
    """Return (N,): a number per row; rows with equal chosen features have the same."""
    seen = stacked(chosen, rows).astype(np.float32)  # precision of the trees
    return np.unique(seen, axis=0, return_inverse=True)[1].ravel()


def _missing(
    examples: Examples,
    chosen: Sequence[FeatureColumn],
    left: Sequence[FeatureColumn],
    rng: np.random.Generator,
    blocks: Ints | None = None,
    first: Flags | None = None,
) -> str:
    """
    Return the feature that best explains labels that the chosen features do not explain.

    :param left: the other features.
    :param blocks: (N,) groups within which labels are shuffled; None: rows with equal features.
    :param first: (N,) starts, which count only if labelled as ends; None: all examples count.
    :return: the feature; empty: none explains more than it would by chance.
    """
    labels, looks = examples.labels, _looks(examples.rows, chosen)
    blocks = looks if blocks is None else blocks
    in_order = np.argsort(blocks, kind='stable')

    def exceptions(cells: Ints, labels: Ints) -> int:
        """Return the number of examples without the most frequent label of their cell."""
        if first is not None:
            counted = ~first | (labels == MEMBER)
            cells, labels = cells[counted], labels[counted]
        shape = cells.max() + 1, labels.max() + 1
        table = np.bincount(cells * shape[1] + labels, minlength=shape[0] * shape[1])
        return int(len(labels) - table.reshape(shape).max(axis=1).sum())

    cells, explained, all_ = dict[str, Ints](), dict[str, int](), exceptions(looks, labels)
    for column in left:
        values, feature = column.values(examples.rows), column.feature
        if feature.kind is FeatureKind.CONTINUOUS:
            values = np.floor(TENTHS * (values - feature.low) / feature.span)
        value = np.unique(values, return_inverse=True)[1].ravel()
        cells[feature.name] = cell = looks * (value.max() + 1) + value
        explained[feature.name] = all_ - exceptions(cell, labels)
    best = sorted(cells, key=lambda name: (-explained[name], len(np.unique(cells[name]))))
    shuffles = max(SHUFFLES, round(2 * len(left) / (1 - LEVEL)))
    for name in best[:TRIED]:
        if explained[name] <= 0:
            break
        chances = (1 - LEVEL) / len(left) * (shuffles + 1) - 1
        for _ in range(shuffles):
            drawn = np.empty_like(labels)
            drawn[in_order] = labels[np.lexsort((rng.random(len(labels)), blocks))]
            chances -= exceptions(looks, drawn) - exceptions(cells[name], drawn) >= explained[name]
            if chances < 0:
                break
        else:
            return name
    return ''


def _one_per_demonstration(examples: Examples, chosen: Sequence[FeatureColumn]) -> Examples:
    """Return the first example of each demonstration in each situation; later ones repeat it."""
    key = np.stack([_looks(examples.rows, chosen), examples.source])
    first = np.unique(key, axis=1, return_index=True)[1]
    return Examples(examples.rows[first], examples.labels[first], examples.source[first])
