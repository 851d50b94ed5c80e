"""
Choosing the next state to show, from the rules and the learned trees alone.

``random`` is the paper's way (section 5). ``failures`` shows states from which the learned option
does not do what was shown: of these, the one whose shortest ways to an end go through the most
situations that fail and were not shown yet, so that one demonstration teaches the most.
"""

from collections.abc import Callable, Sequence
from typing import Any

from humanopts_env.domains.base import Domain, EnumerableDomain, FeatureKind, is_enumerable
from humanopts_env.domains.tabular import reachable
from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.options.failures import (
    failing_samples,
    has_new_value,
    is_surveyable,
    Survey,
    survey,
)
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.trees.encoding import encode_rows, encoding
import numpy as np
from numpy.typing import NDArray

SAMPLE = 500  # states among which coverage looks for the most distant
ALREADY_SHOWN = 0.1  # weight of a failing situation that was shown, against 1
Floats = NDArray[np.float64]


class UnknownStrategyError(ValueError):
    """There is no such strategy; the text lists them."""


def choose_start_state(
    strategy: str,
    domain: Domain[Any],
    option: LearnedOption | None,
    demonstrations: Sequence[Demonstration],
    rng: np.random.Generator,
) -> Any:
    """
    Choose the state from which to ask for the next demonstration.

    :param strategy: one of ``STRATEGIES``.
    :param option: what was learned from the demonstrations; None: nothing yet.
    :param demonstrations: of this participant and option, "not here" answers too.
    :raises UnknownStrategyError: there is no such strategy.
    """
    if strategy not in STRATEGIES:
        raise UnknownStrategyError(
            f'no start-state strategy {strategy!r}; there is {", ".join(STRATEGIES)}'
        )
    return STRATEGIES[strategy](domain, option, demonstrations, rng)


def _random(
    domain: Domain[Any],
    option: LearnedOption | None,
    demonstrations: Sequence[Demonstration],
    rng: np.random.Generator,
) -> Any:
    return domain.sample_states(rng, 1)[0]


def _coverage(
    domain: Domain[Any],
    option: LearnedOption | None,
    demonstrations: Sequence[Demonstration],
    rng: np.random.Generator,
) -> Any:
    """
    Return the state that is farthest, in the chosen features, from every state shown.

    Once there is an option, only states where it can start, or with a value that nobody showed.
    """
    if not demonstrations:
        return _random(domain, option, demonstrations, rng)
    states = _candidates(domain, rng)
    rows = np.array([domain.feature_values(state) for state in states])
    shown = np.unique(np.concatenate([d.feature_rows for d in demonstrations]), axis=0)
    columns = encoding(domain, demonstrations[-1].chosen_features)
    if option is not None:
        picked = sorted({column.index for column in columns})
        kept = option.can_start(rows) | has_new_value(rows[:, picked], shown[:, picked])
        if kept.any():
            states, rows = [s for s, keep in zip(states, kept) if keep], rows[kept]
    features = [domain.features[column.index] for column in columns]
    # An ordinal feature differs by 0..1, a nominal one by 0 or 1: half in each of two columns.
    scale = [
        1 / max(len(f.values) - 1, 1) if f.kind is FeatureKind.ORDINAL else 0.5 for f in features
    ]
    here, there = (encode_rows(columns, part) * np.array(scale) for part in (rows, shown))
    distance = np.zeros((len(here), len(there)))
    for ours, theirs in zip(here.T, there.T):
        distance += np.abs(np.subtract.outer(ours, theirs))
    return states[_best(distance.min(axis=1), rng)]


def _failures(
    domain: Domain[Any],
    option: LearnedOption | None,
    demonstrations: Sequence[Demonstration],
    rng: np.random.Generator,
) -> Any:
    if option is None:
        return _coverage(domain, option, demonstrations, rng)
    if is_enumerable(domain) and is_surveyable(domain):
        found = survey(option, domain, demonstrations)
        return domain.state_at(_instructive_state(domain, found, rng))
    failing = failing_samples(option, domain, rng)
    if failing:
        return failing[int(rng.integers(len(failing)))]
    return _coverage(domain, option, demonstrations, rng)


STRATEGIES: dict[str, Callable[..., Any]] = {
    'random': _random,
    'coverage': _coverage,
    'failures': _failures,
}


def _instructive_state(
    domain: EnumerableDomain[Any], found: Survey, rng: np.random.Generator
) -> int:
    """
    Return the state from which a demonstration teaches the most.

    While states are stuck, those; then those on a detour; and when nothing fails, the state whose
    ways go through what was shown least often, so that no lesson rests on one demonstration.
    """
    lost = found.stuck & (found.distance < 0) & (found.times_shown == 0)
    if lost.any():  # no end like theirs was shown yet
        return int(rng.choice(np.flatnonzero(lost)))
    failing = found.stuck if found.stuck.any() else found.detour
    if failing.any():
        among = failing
        weight = np.where(found.times_shown == 0, 1.0, ALREADY_SHOWN) * failing
    else:
        among = found.candidate
        weight = among / (1.0 + found.times_shown) ** 2
    states = np.flatnonzero(among)
    return int(states[_best(_weight_on_the_way(domain, found, weight)[states], rng)])


def _weight_on_the_way(domain: EnumerableDomain[Any], found: Survey, weight: Floats) -> Floats:
    """Return (S,): the summed weight of the states on shortest ways, their mean where several."""
    successor = domain.transitions().successor[:, :, 0]
    total = weight.astype(np.float64)
    for steps in range(2, int(found.distance.max()) + 1):
        at = np.flatnonzero(found.distance == steps)
        nearer = found.nearer[at]
        total[at] += (total[successor[at]] * nearer).sum(axis=1) / nearer.sum(axis=1)
    return total


def _candidates(domain: Domain[Any], rng: np.random.Generator) -> list[Any]:
    if not is_enumerable(domain):
        return domain.sample_states(rng, SAMPLE)
    states = np.flatnonzero(reachable(domain) & ~domain.over())
    some = rng.permutation(states)[:SAMPLE]
    return [domain.state_at(int(index)) for index in some]


def _best(score: Floats, rng: np.random.Generator) -> int:
    """Return an index of the highest score, any of those that are equal."""
    return int(rng.choice(np.flatnonzero(score >= score.max() - 1e-9)))
