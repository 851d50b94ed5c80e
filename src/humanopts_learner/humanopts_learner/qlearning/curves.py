"""A search for rates that is equally long for every action set."""

from collections.abc import Sequence
from typing import Any

from humanopts_env.domains.base import EnumerableDomain
from humanopts_env.seeding import generator
from humanopts_learner.qlearning.choices import Choices
from humanopts_learner.qlearning.learn import learn, Method, Progress, Rates

SLOWEST, FASTEST = 0.05, 1.0  # learning rates that are tried
LEAST, MOST = 0.005, 0.3  # shares of exploring decisions that are tried


def drawn_rates(seed: int, count: int) -> list[Rates]:
    """Draw rates to try, uniformly in their logarithms; the first are the usual ones, 0.1."""
    rng = generator(seed, 'rates')
    draws = rng.random((count - 1, 2))
    learning = SLOWEST * (FASTEST / SLOWEST) ** draws[:, 0]
    exploring = LEAST * (MOST / LEAST) ** draws[:, 1]
    return [Rates(), *(Rates(float(a), float(b)) for a, b in zip(learning, exploring))]


def best_rates(
    domain: EnumerableDomain[Any],
    choices: Choices,
    candidates: Sequence[Rates],
    runs: int,
    episodes: int,
    seed: int,
    method: Method = Method.SMDP,
    max_steps: int = 0,
    progress: Progress | None = None,
) -> Rates:
    """
    Return the rates with the fewest steps in all episodes, on the mean over some runs.

    Give every action set the same candidates, runs and episodes. Learn anew with another seed to
    judge what was chosen.

    :param runs: learners for each candidate.
    :raises PlanError: as ``learn``.
    """
    every = [rates for rates in candidates for _ in range(runs)]
    learning = learn(domain, choices, every, episodes, seed, method, None, max_steps, progress)
    score = learning.steps.reshape(len(candidates), -1).mean(axis=1)
    return candidates[int(score.argmin())]
