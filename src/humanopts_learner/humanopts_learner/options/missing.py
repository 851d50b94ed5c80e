"""
Gaps in the demonstrations of an option, in a world where states cannot be chosen.

The person drives to the next start, and needs to know which start would help. A suggestion is
found in the feature rows that were seen, in demonstrations and between them. It is the first of

1. a value of a nominal feature that was seen where the option does not end, but at no start;
2. the range of a feature in which a tenth of the demonstrations decides what the option does
   (``committee_disagrees``), if one range contains most such rows and few others;
3. the largest gap between starts in the range of a feature, if rows were seen in it;
4. the same as 1 and 3 for unseen values and gaps, as long as there are few starts.

Only the chosen features count. *Not here* answers count as starts, too.
"""

from collections.abc import Iterator, Sequence

from humanopts_env.arrays import Flags, Floats, Rows
from humanopts_env.domains.base import ActableDomain, Feature, FeatureKind
from humanopts_env.domains.formulas import plain_name
from humanopts_learner.demonstrations import Demonstration, Kind
from humanopts_learner.options.learn import make_dataset
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_learner.options.starts import committee_disagrees
import numpy as np

GAP = 0.25  # smallest gap between starts that counts, as a share of the range of the feature
FEW = 5  # maximum number of starts for suggesting states that were never seen
SHARE = 0.05  # smallest share of rows in which the committee disagrees
APART = 0.3  # smallest difference between the shares of these rows and of others in a range
PARTS = 10  # parts of a continuous feature's range; they bound the suggested ranges


def missing_start(
    option: LearnedOption,
    domain: ActableDomain,
    demonstrations: Sequence[Demonstration],
    passed: Rows,
    seed: int,
) -> str:
    """
    Describe a start that no demonstration has shown yet; empty: none was found.

    :param option: option learned from the demonstrations.
    :param demonstrations: checked demonstrations of this option, with at least one trajectory.
    :param passed: (N, F) features of states seen between demonstrations.
    :param seed: random seed of the folds.
    """
    data = make_dataset(demonstrations, domain)
    starts = np.concatenate([demo.feature_rows[:1] for demo in data.demonstrations])
    seen = np.concatenate(
        [
            passed,
            *(
                demo.feature_rows[:-1] if demo.kind is Kind.TRAJECTORY else demo.feature_rows
                for demo in data.demonstrations
            ),
        ]
    )
    columns = [(each.feature, each.values(starts), each.values(seen)) for each in data.chosen]
    absent = [
        (f'no demonstration starts with {plain_name(feature.name)} {feature.text(value)}', known)
        for feature, of_starts, of_seen in columns
        if feature.kind is FeatureKind.NOMINAL
        for value in range(len(feature.values))
        if value not in of_starts
        for known in [value in of_seen]
    ]
    gaps = [
        (f'no demonstration starts with {text}', known)
        for _, text, known in sorted(_gaps(columns), key=lambda gap: -gap[0])
    ]
    disagreed = committee_disagrees(option, domain, demonstrations, seen, seed)
    reasons = [
        *(text for text, known in absent if known),
        *_where(columns, disagreed),
        *(text for text, known in gaps if known),
        *(text for text, known in (*absent, *gaps) if not known and len(starts) <= FEW),
    ]
    return next(iter(reasons), '')


def _gaps(
    columns: Sequence[tuple[Feature, Floats, Floats]],
) -> Iterator[tuple[float, str, bool]]:
    """Yield gaps between starts: share of the range, text, and whether rows were seen there."""
    for feature, starts, seen in columns:
        if feature.kind is FeatureKind.NOMINAL:
            continue
        low, high = _limits(feature)
        known, others = (float(seen.min()), float(seen.max())), np.setdiff1d(seen, starts)
        edges = np.unique([low, *known, *starts, high])
        for begin, end in zip(edges[:-1].tolist(), edges[1:].tolist()):
            share = (end - begin) / feature.span
            if share > GAP:
                inside = known[0] <= begin and end <= known[1]
                inside &= bool(((others >= begin) & (others <= end)).any())
                at_limit = begin in (low, known[0]), end in (high, known[1])
                is_open = [at and edge not in starts for at, edge in zip(at_limit, (begin, end))]
                yield share, _words(feature, (begin, end), *is_open), inside


def _where(columns: Sequence[tuple[Feature, Floats, Floats]], disagreed: Flags) -> Iterator[str]:
    """Yield the range of a feature in which the committee disagrees, if one stands out."""
    if not SHARE <= disagreed.mean() < 1:
        return
    best, text = APART, ''
    for feature, _, seen in columns:
        if feature.kind is FeatureKind.NOMINAL:
            ranges = [
                (seen == value, f'{plain_name(feature.name)} {feature.text(value)}')
                for value in np.unique(seen).tolist()
            ]
        else:
            low, high = _limits(feature)
            edges = np.linspace(low, high, PARTS + 1)[1:-1].tolist()
            if feature.kind is FeatureKind.ORDINAL:
                edges = list(range(int(low) + 1, int(high)))
            ranges = [
                (inside, _words(feature, (edge, edge), below, not below))
                for edge in edges
                for inside, below in ((seen < edge, True), (seen > edge, False))
            ]
        for inside, words in ranges:
            apart = inside[disagreed].mean() - inside[~disagreed].mean()
            if apart > best:
                best, text = float(apart), f'demonstrations disagree with {words}'
    if text:
        yield text


def _limits(feature: Feature) -> tuple[float, float]:
    """Return the lowest and the highest value of a feature that is not nominal."""
    if feature.kind is FeatureKind.CONTINUOUS:
        return feature.low, feature.high
    return 0.0, float(len(feature.values) - 1)


def _words(feature: Feature, ends: tuple[float, float], below: bool, above: bool) -> str:
    """Return a range of a feature in words; it may be open below or above."""
    name, texts = plain_name(feature.name), [feature.text(end) for end in ends]
    if feature.kind is FeatureKind.CONTINUOUS:
        texts = [f'{end:.2g} {feature.unit}'.strip() for end in ends]
    if below:
        return f'{name} below {texts[1]}'
    return f'{name} above {texts[0]}' if above else f'{name} {" to ".join(texts)}'
