"""Whether an option fails from any state, and from which of a sample where not all can be run."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from humanopts_env.arrays import Flags, Rows
from humanopts_env.domains.base import Domain
from humanopts_env.domains.capabilities import feature_rows
from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.options.criteria import fit_leave_fold_out, fold_of
from humanopts_learner.options.failures import find_failures, in_doubt
from humanopts_learner.options.learn import make_dataset
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.options.rollout import is_deterministic, rollouts
import numpy as np

SAMPLE = 500  # states that stand for all, where they cannot all be run
RUNS = 50  # of these, from which the option is run
TOLERATED = 0.1  # share of failing ones with which a lesson may end


@dataclass(frozen=True)
class SampledFailures:
    """The outcome of running an option from a sample of states, where they cannot all be run."""

    states: list[Any]  # (N,)
    member: Flags  # (N,) in the learned I
    failing: Flags  # (N,) no end before ``max_steps``, in doubt, or a committee disagrees

    @property
    def share(self) -> float:
        """Of the states where the option can start or fails, those from which it fails."""
        return float(self.failing.sum() / max(1, (self.member | self.failing).sum()))


def sample_failures(
    option: LearnedOption,
    domain: Domain[Any],
    demonstrations: Sequence[Demonstration],
    rng: np.random.Generator,
    drawn: Sequence[Any] | None = None,
) -> SampledFailures:
    """
    Look at ``SAMPLE`` states, and run the option from ``RUNS`` of those where it can start.

    :param demonstrations: those that the option was learned from.
    :param drawn: the states, which ``rng`` has drawn; None: they are drawn here.
    """
    states = domain.sample_states(rng, SAMPLE) if drawn is None else list(drawn)
    rows = feature_rows(domain, states)
    member = option.can_start(rows)
    failing = in_doubt(option, rows, demonstrations)
    failing |= committee_disagrees(option, domain, demonstrations, rows, int(rng.integers(2**31)))
    some = np.flatnonzero(member)[:RUNS]
    runs = rollouts(option, domain, [states[at] for at in some], int(rng.integers(2**31)))
    failing[some] |= ~runs.reached
    return SampledFailures(states, member, failing)


def committee_disagrees(
    option: LearnedOption,
    domain: Domain[Any],
    demonstrations: Sequence[Demonstration],
    rows: Rows,
    seed: int,
) -> Flags:
    """
    Return (N,): in which rows (N, F) a tenth of the demonstrations decides what the option does.

    Query by committee (Seung, Opper and Sompolinsky 1992): the option is learned again without
    each of ten folds. Where one of these differs in I, or in the action inside I, too little was
    shown, or a slip counts too much. One trajectory has no committee: it disagrees all over I.
    """
    inside, action = option.can_start(rows), option.greedy_action(rows)
    data = make_dataset(demonstrations, domain)
    if len(data.trajectories) < 2:
        return inside
    found = np.zeros(len(rows), dtype=np.bool_)
    for other in fit_leave_fold_out(data, fold_of(data, seed), domain, seed):
        found |= other.can_start(rows) != inside
        found |= inside & (other.greedy_action(rows) != action)
    return found


def nothing_fails(
    option: LearnedOption,
    domain: Domain[Any],
    demonstrations: Sequence[Demonstration],
    rng: np.random.Generator,
) -> bool:
    """
    Return whether the option fails from no state, or from few where they cannot all be run.

    :param rng: draws the states then.
    """
    if is_deterministic(domain):
        return not find_failures(option, domain, demonstrations).failing.any()
    return sample_failures(option, domain, demonstrations, rng).share <= TOLERATED
