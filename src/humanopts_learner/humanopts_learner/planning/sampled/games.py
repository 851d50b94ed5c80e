"""
Runs of options in many games side by side, to evaluate a policy or to sample option models.

What one policy plays or samples with one generator is a *process*: a Python generator that yields
a batch whenever it needs to see its games. Several processes with the same options go on in step,
and their games are looked at as one batch, which costs little more than one of them. Games do not
affect each other, so a process has the same result as alone.

Sampling counts every suffix of a run. A run of option o from s0 to sk, where o could also have
started at s1, .., sk-1, is a sample of running it from each of those states too, since a Markov
option does not depend on earlier states (Precup 2000, chapter 4). From a state where o could not
have started, it is a sample of continuing o there. Runs that are cut off (by ``max_steps``, the
length of an episode, or the end of the sampling) and runs that the policy stops count as having
ended where they were.
"""

from collections.abc import Callable, Generator, Sequence
import math
from typing import Any, TypeVar

from humanopts_env.arrays import Flags, Ints
from humanopts_env.seeding import generator
from humanopts_learner.planning.evaluate import Returns
from humanopts_learner.planning.request import ignore_progress, PlanError, Progress
from humanopts_learner.planning.sampled.action_set import ActionSet, Observation
from humanopts_learner.planning.sampled.policies import Choice, Policy
from humanopts_learner.planning.sampled.sampled_models import SampleCounts, Samples
import numpy as np
from numpy.typing import NDArray

BLOCK = 1_000_000  # game steps that are kept before they are counted
FINISHED_SHARE = 0.3  # games that are over are dropped once they are so many of all
Result = TypeVar('Result')
Process = Generator[Any, Observation, Result]  # yields batches, and is sent what is seen of them


def run_in_step(actions: ActionSet, processes: Sequence[Process[Result]]) -> list[Result]:
    """
    Run processes to their ends, and return their results in order.

    :param actions: the action set of all.
    """
    results: dict[int, Result] = {}
    seen: dict[int, Any] = dict.fromkeys(range(len(processes)))  # None begins a generator
    while seen:
        batches = {}
        for number, observation in seen.items():
            try:
                batches[number] = processes[number].send(observation)
            except StopIteration as end:
                results[number] = end.value
        seen = dict(zip(batches, actions.observe(list(batches.values())))) if batches else {}
    return [results[number] for number in range(len(processes))]


class Runs:
    """
    N games in each of which one option runs at a time.

    :ivar option: (N,) index of the running option; -1: a choice is due.
    :ivar ran: (N,) steps of the running option so far.
    :ivar seen: the current observation of the games.
    """

    def __init__(
        self,
        actions: ActionSet,
        batch: Any,
        seen: Observation,
        rng: np.random.Generator,
    ) -> None:
        self.actions, self._games, self._rng = actions, actions.games, rng
        self.batch, self.seen = batch, seen
        self.option = np.full(len(self.seen.states), -1, dtype=np.intp)
        self.ran = np.zeros(len(self.option), dtype=np.intp)

    def decide(self, policy: Policy) -> tuple[Ints, Choice]:
        """
        Begin an option wherever none runs or the running one is stopped.

        :return: indices of these games (M,), and the choices in them.
        """
        stopped = policy.stops(self.seen, self.option, self._rng)
        free = np.flatnonzero((self.option < 0) | stopped)
        all_free = len(free) == len(stopped)
        choice = policy(self.seen if all_free else self.seen.take(free), self._rng)
        self.option[free], self.ran[free] = choice.option, 0
        return free, choice

    def step(
        self, cut_off: Flags | None = None
    ) -> Process[tuple[NDArray[Any], Flags, Flags, NDArray[np.int64]]]:
        """
        Take one step.

        Games that begin again are looked at together with the others, which saves time.

        :param cut_off: (N,) games that begin again after the step, as all that are over then;
            None: none begins again.
        :return: rewards, which options ended, which games are over, and the abstract states after
            the step, (N,) each.
        """
        games, actions, count = self._games, self.actions, len(self.option)
        action = actions.actions(self.seen, self.option)
        reward = games.batch_step(self.batch, action, self._rng)
        over = games.batch_over(self.batch)
        last = np.flatnonzero(over | cut_off) if cut_off is not None else np.arange(0)
        if last.size:
            fresh = games.batch_reset(len(last), self._rng)
            both = games.batch_take(self.batch, np.concatenate([np.arange(count), last]))
            games.batch_put(both, np.arange(count, count + len(last)), fresh)
            games.batch_put(self.batch, last, fresh)
            seen = yield both
            self.seen = seen.part(0, count)
        else:
            seen = self.seen = yield self.batch
        self.ran += 1
        ended = over | (self.ran >= actions.limits[self.option])
        ended |= actions.ends(self.seen, self.option)
        states = self.seen.states.copy()
        if last.size:
            self.seen.put(last, seen.part(count, count + len(last)))
        return reward, ended, over, states

    def keep(self, chosen: Ints) -> None:
        """Keep chosen games (M,) only."""
        self.batch = self._games.batch_take(self.batch, chosen)
        self.seen = self.seen.take(chosen)
        self.option, self.ran = self.option[chosen], self.ran[chosen]


def play_games(
    actions: ActionSet,
    policy: Policy,
    gamma: float,
    seed: int,
    episodes: int,
    progress: Progress = ignore_progress,
) -> Returns:
    """Play games from the start of the task by a policy; as ``playing``."""
    return run_in_step(actions, [playing(actions, policy, gamma, seed, episodes, progress)])[0]


def playing(
    actions: ActionSet,
    policy: Policy,
    gamma: float,
    seed: int,
    episodes: int,
    progress: Progress = ignore_progress,
) -> Process[Returns]:
    """
    Play games from the start of the task by a policy.

    :param episodes: number of episodes, E, all side by side; games do not affect each other, but
        the random draws of each depend on E.
    :param progress: called with the stage evaluation; what it raises passes through.
    :raises PlanError: the domain never cuts an episode off, or ``episodes`` is below 1.
    """
    games = actions.games
    limit = games.domain.max_steps
    if limit < 1 or episodes < 1:
        raise PlanError(f'cannot play {episodes} episodes of at most {limit} steps')
    rng = generator(seed, 'play_games')
    batch = games.batch_reset(episodes, rng)
    outcomes = {name: values.copy() for name, values in games.batch_outcome(batch).items()}
    over = games.batch_over(batch)
    returns = Returns.of_none(over.copy(), outcomes)
    runs, at = Runs(actions, batch, (yield batch), rng), np.arange(episodes)
    for step in range(limit):
        progress('evaluation', step / limit, 0, math.nan)
        if not over.all():
            yield from _play_step(returns, runs, policy, gamma, at, over)
            over = games.batch_over(runs.batch)
        if over.mean() >= FINISHED_SHARE:
            _keep_outcomes(returns, runs, at, over)
            at, over = at[~over], over[~over]
            runs.keep(np.flatnonzero(~games.batch_over(runs.batch)))
        if not len(at):
            break
    _keep_outcomes(returns, runs, at, np.ones(len(at), dtype=np.bool_))
    return returns


def _play_step(
    returns: Returns,
    runs: Runs,
    policy: Policy,
    gamma: float,
    at: Ints,
    over: Flags,
) -> Process[None]:
    """
    Take one step in M games, and add it to their returns.

    :param at: (M,) indices of these games among the E.
    :param over: (M,) whether each is over; these are not counted.
    """
    live = at[~over]
    free, choice = runs.decide(policy)
    going = ~over[free]
    deciding = at[free[going]]
    returns.decisions[deciding] += 1
    returns.fallbacks[deciding] += (choice.option >= runs.actions.first_fallback)[going]
    returns.unknown[deciding] += choice.unknown[going]
    reward, ended, now_over, _ = yield from runs.step()
    runs.option[ended] = -1
    returns.total[live] += reward[~over]
    returns.discounted[live] += gamma ** returns.steps[live] * reward[~over]
    returns.steps[live] += 1
    returns.successes[at] = now_over


def _keep_outcomes(returns: Returns, runs: Runs, at: Ints, chosen: Flags) -> None:
    """Keep the outcomes of chosen games (M,) when they are dropped."""
    for name, values in runs.actions.games.batch_outcome(runs.batch).items():
        returns.outcomes[name][at[chosen]] = values[chosen]


class Recording:
    """T steps of N games."""

    def __init__(self, length: int, count: int) -> None:
        shape = (length, count)
        self.state = np.empty(shape, dtype=np.int64)  # abstract
        self.option = np.empty(shape, dtype=np.int16)
        self.modelled = np.empty(shape, dtype=np.bool_)
        self.reward = np.empty(shape)
        self.ended = np.empty(shape, dtype=np.bool_)
        self.over = np.empty(shape, dtype=np.bool_)
        self.successor = np.empty(shape, dtype=np.int64)  # abstract state after the step

    def samples(self, gamma: float) -> Samples:
        """Return every suffix of every run, by one pass backwards."""
        reward = self.reward
        successor = self.successor
        discount = np.where(self.over, 0.0, gamma)
        self.ended[-1] = True
        for t in range(len(reward) - 2, -1, -1):
            on = ~self.ended[t]
            reward[t] += np.where(on, gamma * reward[t + 1], 0.0)
            discount[t] = np.where(on, gamma * discount[t + 1], discount[t])
            successor[t] = np.where(on, successor[t + 1], successor[t])
        kept = self.modelled
        return Samples(
            self.state[kept],
            self.option[kept].astype(np.intp),
            reward[kept],
            discount[kept],
            successor[kept],
        )


class Sampler:
    """N games that continue from round to round; their runs are counted as samples."""

    def __init__(
        self,
        actions: ActionSet,
        counts: SampleCounts,
        n_games: int,
        gamma: float,
        rng: np.random.Generator,
    ) -> None:
        """Begin games at the start of the task, with the first step."""
        self._actions, self._counts, self._gamma, self._rng = actions, counts, gamma, rng
        self._limit = actions.games.domain.max_steps or np.iinfo(np.intp).max
        self._runs: Runs | None = None
        self._age = np.zeros(n_games, dtype=np.intp)

    def play(self, policy: Policy, steps: int, on_steps: Callable[[int], object]) -> Process[int]:
        """
        Continue by a policy, and count the runs.

        :param steps: game steps in all, rounded down to whole steps of all games.
        :param on_steps: called with the game steps so far.
        :return: game steps taken.
        """
        n_games = len(self._age)
        if self._runs is None:
            batch = self._actions.games.batch_reset(n_games, self._rng)
            self._runs = Runs(self._actions, batch, (yield batch), self._rng)
        left, done = steps // n_games, 0
        while left:
            recording = Recording(min(left, max(BLOCK // n_games, 1)), n_games)
            self._runs.option[:] = -1
            for t in range(len(recording.reward)):
                yield from self._step(self._runs, policy, recording, t)
                done += n_games
                on_steps(done)
            self._counts.add(recording.samples(self._gamma))
            left -= len(recording.reward)
        return done

    def _step(self, runs: Runs, policy: Policy, recording: Recording, t: int) -> Process[None]:
        fallback = self._actions.first_fallback
        decided, _ = runs.decide(policy)
        if t:
            recording.ended[t - 1, decided] = True  # those that were stopped
        inside = self._actions.can_start(runs.seen, runs.option)
        recording.state[t] = runs.seen.states
        recording.option[t] = np.where(inside, runs.option, runs.option + fallback)
        recording.modelled[t] = runs.option < fallback
        self._age += 1
        cut_off = self._age >= self._limit
        recording.reward[t], ended, over, recording.successor[t] = yield from runs.step(cut_off)
        last = over | cut_off
        recording.over[t], recording.ended[t] = over, ended | last
        runs.option[recording.ended[t]] = -1
        self._age[last] = 0
