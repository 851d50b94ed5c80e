"""
Segments of a play: demonstrations of options, cut from a demonstration of the whole task.

P. Zang, P. Zhou, D. Minnen and C. Isbell (2009), "Discovering options from example trajectories",
cut trajectories where the task changes. Here, the cuts are *events*: changes of nominal features
that change rarely, such as the object carried, or whether a door is open. A person names the
segments, joins neighbours by giving them the same name, and omits others by giving no name.

The threshold for rare changes comes from the data. Features that describe the stages of a task
change a few times in a play; those that describe the surroundings, such as the object in front,
change every few steps, at least in random walks, which are longer. So the logarithms of the rates
form two groups, and N. Otsu's threshold (1979, "A threshold selection method from gray-level
histograms") separates them with the least variance within groups.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

from humanopts_env.arrays import Flags, Floats, Ints, Rows
from humanopts_env.domains.base import ActableDomain, Domain, DomainError, FeatureKind
from humanopts_env.domains.described import can_simulate
from humanopts_env.games import feature_rows
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import Demonstration, Kind
import numpy as np

WALKS, WALK = 4, 100  # random walks, and maximum steps of each
OVER = 'the task is over'
STOPPED = 'the play stops'


@dataclass(frozen=True)
class Segment:
    """
    Part of a play, from the state after an event to the state after the next one.

    :ivar play: the whole play.
    :ivar first: step of the first state.
    :ivar last: step of the last state.
    :ivar end: events at the end, such as ``carrying: nothing -> key``.
    """

    play: Demonstration
    first: int
    last: int
    end: tuple[str, ...]

    def demonstration(self, option_name: str, features: Sequence[str]) -> Demonstration:
        """
        Return the segment as a demonstration of an option, without a number and a uuid.

        :param features: names of the features that the option depends on.
        """
        play, steps = self.play, slice(self.first, self.last)
        states = slice(self.first, self.last + 1)
        return replace(
            play,
            kind=Kind.TRAJECTORY,
            uuid='',
            option_name=option_name,
            number=0,
            chosen_features=tuple(features),
            features=play.features[states],
            states=play.states[states],
            actions=play.actions[steps],
            rewards=play.rewards[steps],
            terminated=play.terminated and self.last == len(play.actions),
            can_start_at_end=False,
            seconds=play.seconds * (self.last - self.first) / len(play.actions),
            machine_steps=0,
        )


def event_features(domain: ActableDomain, plays: Sequence[Demonstration]) -> tuple[str, ...]:
    """
    Return the names of nominal features with changes that are events, in the domain's order.

    If only one or two nominal features change, all their changes are events.

    :param plays: one or more plays; more of them give more accurate rates.
    """
    rates = _rates([play.feature_rows for play in plays])
    nominal = [feature.kind is FeatureKind.NOMINAL for feature in domain.features]
    found = np.flatnonzero(nominal & (rates > 0))
    if can_simulate(domain):
        rates = np.maximum(rates, _rates([_walk(domain, number) for number in range(WALKS)]))
    logarithms = np.log(rates[found])
    if len(found) > 2:
        found = found[logarithms < _otsu(logarithms)]
    return tuple(domain.features[column].name for column in found.tolist())


def _rates(trajectories: Sequence[Rows]) -> Floats:
    """Return the share of steps in which each feature changes, (F,)."""
    changes = np.concatenate([np.diff(rows, axis=0) != 0 for rows in trajectories])
    return np.asarray(changes.mean(axis=0), dtype=np.float64)


def _walk(domain: Domain, number: int) -> Rows:
    """Return the features along a random walk from a start of the task, (T + 1, F)."""
    rng = generator(number, 'walk')
    states = [domain.reset(rng)]
    while not domain.is_over(states[-1]) and len(states) <= WALK:
        action = int(rng.integers(len(domain.actions)))
        states.append(domain.step(states[-1], action, rng).state)
    return feature_rows(domain, states)


def _otsu(values: Floats) -> float:
    """Return the threshold between two groups of values (N,) with the least variance within."""
    ordered = np.sort(values)
    inside = [
        ordered[:n].var() * n + ordered[n:].var() * (len(ordered) - n)
        for n in range(1, len(ordered))
    ]
    cut = int(np.argmin(inside))
    return float(ordered[cut : cut + 2].mean())


def cut(domain: ActableDomain, play: Demonstration, events: Iterable[str]) -> list[Segment]:
    """
    Cut a play after each change of the given features; the last segment ends with the play.

    :param events: names of features.
    :raises DomainError: a feature is unknown.
    """
    columns = {feature.name: n for n, feature in enumerate(domain.features)}
    if unknown := set(events) - set(columns):
        raise DomainError(
            f'{domain.name} has no feature {", ".join(sorted(unknown))}; '
            f'choose from {", ".join(columns)}'
        )
    rows, watched = play.feature_rows, [columns[name] for name in events]
    changed: Flags = np.diff(rows[:, watched], axis=0) != 0  # (T, events)
    total = len(play.actions)
    cuts = sorted({*(np.flatnonzero(changed.any(axis=1)) + 1).tolist(), total})
    segments = []
    for first, last in zip([0, *cuts], cuts):
        words = []
        for column in np.array(watched, dtype=np.intp)[changed[last - 1]].tolist():
            feature = domain.features[column]
            before, after = map(feature.text, rows[last - 1 : last + 1, column])
            words.append(f'{feature.name}: {before} -> {after}')
        if last == total:
            words.append(OVER if play.terminated else STOPPED)
        segments.append(Segment(play, first, last, tuple(words)))
    return segments


def joined(segments: Sequence[Segment], names: Sequence[str]) -> list[tuple[str, Segment]]:
    """
    Return the named segments of one play; neighbours with the same name become one.

    :param segments: segments in order, as ``cut`` returns them.
    :param names: option name of each segment; empty: the segment is omitted.
    """
    found = []
    for name, group in groupby(zip(names, segments), key=lambda pair: pair[0]):
        parts = [segment for _, segment in group]
        if name:
            found.append((name, replace(parts[-1], first=parts[0].first)))
    return found


def suggested_features(domain: ActableDomain, segments: Sequence[Segment]) -> tuple[str, ...]:
    """
    Suggest the features that an option depends on, from its segments.

    These are the features that change at an end, and a small set that determines the actions.
    Features are added to the set one at a time, as long as this lowers the number of cases
    (combinations of feature values) plus exceptions (steps without the most frequent action of
    their case). Continuous features are compared by tenths of their range.

    :param segments: segments of the same option.
    """
    rows = np.concatenate([s.play.feature_rows[s.first : s.last] for s in segments])
    names = [name for s in segments for name in s.play.actions[s.first : s.last]]
    actions = np.unique(names, return_inverse=True)[1]
    for column, feature in enumerate(domain.features):
        if feature.kind is FeatureKind.CONTINUOUS:
            rows[:, column] = np.floor(10 * (rows[:, column] - feature.low) / feature.span)
    chosen: list[int] = []
    cost = _cost(rows[:, chosen], actions)
    while len(chosen) < rows.shape[1]:
        costs = [_cost(rows[:, [*chosen, n]], actions) for n in range(rows.shape[1])]
        best = int(np.argmin(costs))
        if costs[best] >= cost:
            break
        chosen, cost = [*chosen, best], costs[best]
    ends = {word.partition(':')[0] for segment in segments for word in segment.end}
    wanted = {domain.features[n].name for n in chosen} | ends
    suggested = tuple(each.name for each in domain.features if each.name in wanted)
    return suggested or (domain.features[0].name,)


def _cost(rows: Rows, actions: Ints) -> int:
    """Return the number of exceptions plus the number of cases."""
    _, case = np.unique(rows, axis=0, return_inverse=True)
    table = np.zeros((case.max() + 1, actions.max() + 1), dtype=np.intp)
    np.add.at(table, (case.ravel(), actions), 1)
    return int((table.sum(axis=1) - table.max(axis=1)).sum()) + len(table)
