"""
Strategies for the next start state, based only on the rules and the learned trees.

``random`` is the paper's strategy (section 5). ``failures`` chooses among states from which the
learned option does not behave as demonstrated: it takes the one whose shortest paths to an end
pass through the most failing situations not demonstrated yet, so that one demonstration teaches
the most. Once no state is stuck, it asks about states outside I without evidence, and then about
states from which the option takes a detour. If the option cannot be run from all states, it draws
a state from a sample: stuck, without evidence, or decided by a tenth of the demonstrations.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from humanopts_env.arrays import Flags, Floats, Rows
from humanopts_env.domains.base import Domain, EnumerableDomain, is_enumerable
from humanopts_env.domains.formulas import feature_columns
from humanopts_env.domains.tabular import reachable
from humanopts_env.games import feature_rows
from humanopts_learner.demonstrations import Demonstration, Kind
from humanopts_learner.options.decision_tree import encode_rows, feature_encoding
from humanopts_learner.options.failures import (
    Failures,
    find_failures,
    uncertain,
)
from humanopts_learner.options.judge import fit_leave_fold_out, fold_of
from humanopts_learner.options.learn import make_dataset
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_learner.options.rollout import is_deterministic, rollouts
import numpy as np

STRATEGIES = ('random', 'coverage', 'failures')
SHOWN_WEIGHT = 0.1  # weight of a demonstrated failing situation; others: 1
SAMPLE = 500  # number of states, if the option cannot be run from all
RUNS = 50  # number of runs from sampled states
TOLERATED = 0.1  # maximum share of failing states at the end of a lesson


class UnknownStrategyError(ValueError):
    """Unknown strategy; the message lists the strategies."""


def choose_start_state(
    strategy: str,
    domain: Domain,
    option: LearnedOption | None,
    demonstrations: Sequence[Demonstration],
    rng: np.random.Generator,
    drawn: Sequence[Any] | None = None,
) -> Any:
    """
    Choose the start state of the next demonstration.

    :param strategy: one of ``STRATEGIES``.
    :param option: option learned from the demonstrations; None: not learned yet.
    :param demonstrations: those of this participant and option, including "not here" answers.
    :param drawn: result of ``draw_sample`` with the same ``rng``; None: not called.
    :raises UnknownStrategyError: the strategy is unknown.
    """
    if strategy not in STRATEGIES:
        raise UnknownStrategyError(
            f'unknown start-state strategy {strategy!r}; choose from {", ".join(STRATEGIES)}'
        )
    if not any(demo.kind is Kind.TRAJECTORY for demo in demonstrations):
        option = None  # learned from other demonstrations, such as an old option file
    if strategy == 'failures' and option is not None:
        state = _failing_state(domain, option, demonstrations, rng, drawn)
        if state is not None:
            return state
        drawn = None  # a different sample
    if strategy == 'random' or not demonstrations:
        return domain.sample_states(rng, 1)[0]
    if is_enumerable(domain):
        states = _states(domain, reachable(domain) & ~domain.over(), rng)
    else:
        states = domain.sample_states(rng, SAMPLE) if drawn is None else list(drawn)
    if option is not None:
        rows = feature_rows(domain, states)
        kept = option.can_start(rows) | uncertain(option, rows, demonstrations)
        states = [state for state, keep in zip(states, kept) if keep] or states
    return _farthest(domain, states, demonstrations, rng)


def draw_sample(
    strategy: str,
    domain: Domain,
    demonstrations: Sequence[Demonstration],
    rng: np.random.Generator,
) -> list[Any] | None:
    """
    Draw the sample for ``choose_start_state`` in advance; it does not depend on the option.

    :return: the states; None: it does not use a sample.
    """
    if strategy == 'random' or is_enumerable(domain) or not demonstrations:
        return None
    return domain.sample_states(rng, SAMPLE)


def _failing_state(
    domain: Domain,
    option: LearnedOption,
    demonstrations: Sequence[Demonstration],
    rng: np.random.Generator,
    drawn: Sequence[Any] | None,
) -> Any:
    """
    Return a state from which the option fails; None: no such state.

    In a deterministic domain, return an instructive state, even if the option does not fail there.
    """
    if not is_deterministic(domain):
        some = sample_failures(option, domain, demonstrations, rng, drawn)
        failing = np.flatnonzero(some.failing)
        return some.states[int(rng.choice(failing))] if failing.size else None
    found = find_failures(option, domain, demonstrations)
    if found.doubt.any() and not found.stuck.any():
        return _farthest(domain, _states(domain, found.doubt, rng), demonstrations, rng)
    if found.candidate.any():
        return domain.state_at(_instructive_state(domain, found, rng))
    return None


def _instructive_state(domain: EnumerableDomain, found: Failures, rng: np.random.Generator) -> int:
    """
    Return the state from which a demonstration teaches the most.

    Stuck states come first, then detours. If nothing fails, return the state whose paths pass
    through the least demonstrated states, so that no lesson relies on a single demonstration.
    """
    lost = found.stuck & (found.distance < 0) & (found.times_shown == 0)
    if lost.any():  # no path to a demonstrated end
        return int(rng.choice(np.flatnonzero(lost)))
    among = found.stuck if found.stuck.any() else found.detour
    weight = np.where(found.times_shown == 0, 1.0, SHOWN_WEIGHT) * among
    if not among.any():
        among, weight = found.candidate, found.candidate / (1.0 + found.times_shown) ** 2
    # Sum the weights along shortest paths, averaged over equally short ones.
    successor = domain.transitions().successor[:, :, 0]
    for steps in range(2, int(found.distance.max()) + 1):
        at = np.flatnonzero(found.distance == steps)
        nearer = found.nearer[at]
        weight[at] += (weight[successor[at]] * nearer).sum(axis=1) / nearer.sum(axis=1)
    states = np.flatnonzero(among)
    return int(states[_best(weight[states], rng)])


def _farthest(
    domain: Domain,
    states: Sequence[Any],
    demonstrations: Sequence[Demonstration],
    rng: np.random.Generator,
) -> Any:
    """
    Return the state that differs most, in the chosen features, from every demonstrated state.

    Ordinal and continuous features differ by 0..1; nominal ones by 0 or 1, split equally between
    two encoded features.
    """
    chosen = demonstrations[-1].chosen_features
    encoding = feature_encoding(domain, chosen)
    spans = {each.feature.name: each.feature.span for each in feature_columns(domain, chosen)}
    scale = [0.5 if each.value is not None else 1 / spans[each.feature] for each in encoding]
    shown = np.unique(np.concatenate([demo.feature_rows for demo in demonstrations]), axis=0)
    here, there = (
        encode_rows(encoding, r) * np.array(scale) for r in (feature_rows(domain, states), shown)
    )
    distance = np.zeros((len(here), len(there)))
    for ours, theirs in zip(here.T, there.T):
        distance += np.abs(np.subtract.outer(ours, theirs))
    return states[_best(distance.min(axis=1), rng)]


def _states(domain: EnumerableDomain, chosen: Flags, rng: np.random.Generator) -> list[Any]:
    """Return a sample of at most ``SAMPLE`` of the selected states (S,)."""
    some = rng.permutation(np.flatnonzero(chosen))[:SAMPLE]
    return [domain.state_at(int(index)) for index in some]


def _best(score: Floats, rng: np.random.Generator) -> int:
    """Return the index of the highest score, with random tie-breaking."""
    return int(rng.choice(np.flatnonzero(score >= score.max() - 1e-9)))


@dataclass(frozen=True)
class SampledFailures:
    """The outcome of running an option from a sample of states."""

    states: list[Any]  # (N,)
    member: Flags  # (N,) in the learned I
    failing: Flags  # (N,) no end within ``max_steps``, in doubt, or the committee disagrees

    @property
    def share(self) -> float:
        """Share of failing states among those where the option can start or fails."""
        return float(self.failing.sum() / max(1, (self.member | self.failing).sum()))


def sample_failures(
    option: LearnedOption,
    domain: Domain,
    demonstrations: Sequence[Demonstration],
    rng: np.random.Generator,
    drawn: Sequence[Any] | None = None,
) -> SampledFailures:
    """
    Evaluate ``SAMPLE`` states, and run the option from ``RUNS`` of those where it can start.

    :param demonstrations: those from which the option was learned.
    :param drawn: states already drawn from ``rng``; None: draw them.
    """
    states = domain.sample_states(rng, SAMPLE) if drawn is None else list(drawn)
    rows = feature_rows(domain, states)
    member = option.can_start(rows)
    failing = uncertain(option, rows, demonstrations)
    failing |= committee_disagrees(option, domain, demonstrations, rows, int(rng.integers(2**31)))
    some = np.flatnonzero(member)[:RUNS]
    runs = rollouts(option, domain, [states[at] for at in some], int(rng.integers(2**31)))
    failing[some] |= ~runs.reached
    return SampledFailures(states, member, failing)


def committee_disagrees(
    option: LearnedOption,
    domain: Domain,
    demonstrations: Sequence[Demonstration],
    rows: Rows,
    seed: int,
) -> Flags:
    """
    Return (N,): whether a tenth of the demonstrations decides the behaviour in rows (N, F).

    Query by committee (Seung, Opper and Sompolinsky 1992): the option is relearned without each of
    ten folds. If a relearned option differs in I, or in the action inside I, there are too few
    demonstrations, or a slip has too much weight. With one trajectory, the committee disagrees
    everywhere in I.
    """
    inside, action = option.can_start(rows), option.action(rows)
    data = make_dataset(demonstrations, domain)
    if len(data.trajectories) < 2:
        return inside
    found = np.zeros(len(rows), dtype=np.bool_)
    for other in fit_leave_fold_out(data, fold_of(data, seed), domain, seed):
        found |= other.can_start(rows) != inside
        found |= inside & (other.action(rows) != action)
    return found


def nothing_fails(
    option: LearnedOption,
    domain: Domain,
    demonstrations: Sequence[Demonstration],
    rng: np.random.Generator,
) -> bool:
    """
    Return whether the option fails from no state, or from few states of a sample.

    :param rng: generator for the sample, if the option cannot be run from all states.
    """
    if is_deterministic(domain):
        return not find_failures(option, domain, demonstrations).failing.any()
    return sample_failures(option, domain, demonstrations, rng).share <= TOLERATED
