"""Q-learning of ways to targets, many learners side by side (Watkins 1989)."""

from collections.abc import Callable
from dataclasses import dataclass

from humanopts_env.domains.base import Transitions
from humanopts_env.domains.chance import draw_outcomes, outcome_limits
from humanopts_learner.automatic.how import Extraction
from humanopts_learner.planning.errors import PlanError
import numpy as np
from numpy.typing import NDArray

Flags = NDArray[np.bool_]
Ints = NDArray[np.intp]
Tell = Callable[[float, int], object]  # share of the episodes that are done, steps so far
TOLD_EVERY = 200  # steps
LARGEST_TABLES = 2**28  # entries of all learners, 1 GiB


@dataclass(frozen=True)
class Errands:
    """What L learners are to do: come from a start to a target."""

    starts: Ints  # (M,) those of the first learner, of the second, ...
    counts: Ints  # (L,) how many each has, 1 or more; an episode begins in any of them
    target: Flags  # (L, S) worth 1, and ends the episode
    shut: Flags  # (L, S) worth nothing, and ends it as well

    def draw(self, learners: Ints, rng: np.random.Generator) -> Ints:
        """Draw a start for each of some learners (N,)."""
        first = np.cumsum(self.counts) - self.counts
        drawn: Ints = self.starts[first[learners] + rng.integers(self.counts[learners])]
        return drawn


@dataclass(frozen=True)
class Learned:
    """What Q-learning came to."""

    values: NDArray[np.float32]  # (L, S, A)
    game_steps: int


class World:
    """Takes steps by exact transitions, in many games at once."""

    def __init__(self, rules: Transitions) -> None:
        self.rules = rules
        self._limits = None if rules.deterministic else outcome_limits(rules)

    def step(self, state: Ints, action: Ints, rng: np.random.Generator) -> tuple[Ints, Flags]:
        """Return where actions lead, and whether the task is over there, (N,)."""
        outcome: Ints | int = 0
        if self._limits is not None:
            outcome = draw_outcomes(self._limits, state, action, rng.random(len(state)))
        at = state, action, outcome
        return self.rules.successor[at].astype(np.intp), self.rules.terminated[at]


def greedy(values: NDArray[np.floating], rng: np.random.Generator) -> Ints:
    """Return the best of each row (N, A), any of equals."""
    best = values == values.max(axis=1, keepdims=True)
    chosen: Ints = np.where(best, rng.random(values.shape), -1.0).argmax(axis=1)
    return chosen


def learn_to_reach(
    world: World,
    errands: Errands,
    episodes: int,
    how: Extraction,
    rng: np.random.Generator,
    tell: Tell,
) -> Learned:
    """
    Learn to do errands.

    Every learner has a table of its own, plays ``episodes`` episodes one after another, and steps
    together with all others.

    :raises PlanError: the tables would not fit in memory.
    """
    learners = len(errands.counts)
    n_states, n_actions, _ = world.rules.successor.shape
    if learners * n_states * n_actions > LARGEST_TABLES:
        raise PlanError(
            f'{learners} learners of {n_states} states need too large tables: give fewer tasks'
        )
    values = np.zeros((learners, n_states, n_actions), dtype=np.float32)
    done, ran = np.zeros(learners, dtype=np.intp), np.zeros(learners, dtype=np.intp)
    live = np.arange(learners)
    state, rounds, game_steps = errands.draw(live, rng), 0, 0
    while live.size:
        here = state[live]
        action = greedy(values[live, here], rng)
        explore = rng.random(live.size) < how.explore
        action = np.where(explore, rng.integers(n_actions, size=live.size), action)
        there, over = world.step(here, action, rng)
        hit = errands.target[live, there]
        ended = hit | errands.shut[live, there] | over
        goal = np.where(ended, hit, how.gamma * values[live, there].max(axis=1))
        at = live, here, action
        values[at] += how.learning_rate * (goal - values[at])
        state[live] = there
        ran[live] += 1
        ended |= ran[live] >= how.max_steps
        again = live[ended]
        done[again] += 1
        ran[again], state[again] = 0, errands.draw(again, rng)
        game_steps += live.size
        rounds += 1
        if rounds % TOLD_EVERY == 0:
            tell(float(done.sum()) / (learners * episodes), game_steps)
        live = live[done[live] < episodes]
    return Learned(values, game_steps)


def greedy_runs(
    world: World,
    values: NDArray[np.float32],
    errands: Errands,
    learner: Ints,
    state: Ints,
    how: Extraction,
    rng: np.random.Generator,
) -> tuple[Ints, Ints, int]:
    """
    Run learners greedily, R runs side by side.

    :param learner: (R,) which of them runs.
    :param state: (R,) where it begins.
    :return: run (V,) and state (V,) of every visit of the runs that came to their target, start
        and target included, run by run in the order of their steps; and all steps taken.
    """
    live, state = np.arange(len(learner)), state.copy()
    came = np.zeros(len(learner), dtype=np.bool_)
    visits, game_steps = [np.stack([live, state])], 0
    for _ in range(how.max_steps):
        if not live.size:
            break
        who, here = learner[live], state[live]
        there, over = world.step(here, greedy(values[who, here], rng), rng)
        state[live] = there
        visits.append(np.stack([live, there]))
        came[live] = errands.target[who, there]
        game_steps += live.size
        live = live[~(came[live] | errands.shut[who, there] | over)]
    run, visited = np.concatenate(visits, axis=1)
    order = np.argsort(run, kind='stable')
    order = order[came[run[order]]]
    return run[order], visited[order], game_steps
