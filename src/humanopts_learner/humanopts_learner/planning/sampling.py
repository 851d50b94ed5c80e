"""
Sampling of option models from N games that continue from round to round.

Every suffix of a run is a sample. A run of option o from s0 to sk, where o could also have started
at s1, .., sk-1, is a sample of running it from each of those states too, since a Markov option
does not depend on earlier states (Precup 2000, chapter 4). From a state where o could not have
started, it is a sample of continuing o. Runs that are cut off (by ``max_steps``, the episode's
step limit, or the end of sampling) or stopped by the policy count as ended in their last state.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from humanopts_env.arrays import Floats
from humanopts_env.domains.described import simulated
from humanopts_env.games import new_games
from humanopts_learner.execution import Execution, NONE, Policy
from humanopts_learner.planning.abstraction import Codes, StateRows
from humanopts_learner.planning.action_set import ActionSet, Observation
from humanopts_learner.planning.models import MultiTimeModel, SparseRows
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array

BLOCK = 1_000_000  # number of game steps buffered before counting


@dataclass(frozen=True)
class Samples:
    """M finished runs, or final parts of runs."""

    state: Codes  # (M,) initial abstract state
    option: NDArray[np.integer]  # (M,) model index
    reward: Floats  # (M,) sum of gamma**i * r[i], i = 0..k-1
    discount: Floats  # (M,) gamma**k; 0 if the task was over
    successor: Codes  # (M,) final abstract state


class SampleCounts:
    """
    Sums over the samples of S abstract states and O options.

    :ivar states: (S,) codes of the abstract states, in order of first visit.
    :ivar counts: (O, S) number of samples.
    """

    def __init__(self, names: tuple[str, ...], choosable: int = 0) -> None:
        """
        Start without samples.

        :param names: names of the models, (O,).
        :param choosable: number of leading models that can be chosen; 0: all.
        """
        self.names, self._choosable = names, choosable or len(names)
        self.states: Codes = np.empty(0, dtype=np.int64)
        self.counts, self._reward = np.zeros((2, len(names), 0))
        self._rows: SparseRows = csr_array((0, 0))

    def add(self, samples: Samples) -> None:
        """Add samples of known or new states."""
        old, (count, _) = len(self.states), self.counts.shape
        codes = np.concatenate([samples.state, samples.successor])
        row = StateRows(self.states)(codes)
        fresh = row < 0
        new, row[fresh] = np.unique(codes[fresh], return_inverse=True)
        row[fresh] += old
        self.states = np.append(self.states, new)
        size, (state, successor) = len(self.states), np.split(row, 2)
        pair, wider = samples.option * size + state, ((0, 0), (0, size - old))

        def total(known: Floats, weights: Floats | None = None) -> Floats:
            new = np.bincount(pair, weights, minlength=count * size).reshape(count, size)
            return np.pad(known, wider) + new

        self.counts = total(self.counts)
        self._reward = total(self._reward, samples.reward)
        rows = self._rows.tocoo()
        option, row = np.divmod(rows.row.astype(np.int64), max(old, 1))
        shape = count * size, size
        known = coo_array((rows.data, (option * size + row, rows.col)), shape).tocsr()
        added = coo_array((samples.discount, (pair, successor)), shape)
        self._rows = known + added.tocsr()

    def model(self, min_samples: int) -> MultiTimeModel:
        """
        Return the mean of the samples.

        Pairs of state and option with fewer than ``min_samples`` are unavailable. States without
        an available pair that can be chosen have no value. Samples that end there count as if they
        had ended like the other samples of their pair; pairs without other samples are also
        unavailable.
        """
        enough = self.counts >= max(min_samples, 1)
        pairs = np.flatnonzero(enough)  # skip the many others
        rows = self._rows[pairs]
        total = rows.sum(axis=1)
        left = np.ones(len(pairs), dtype=np.bool_)
        while True:
            known = np.asarray(enough[: self._choosable].any(axis=0))
            kept = rows @ known
            more = left & ((kept > 0) | (total == 0))
            if (more == left).all():
                break
            left = more
            enough.ravel()[pairs] = left
        scale = np.where(left & (kept > 0), total, 0.0)
        scale /= np.where(kept > 0, kept, 1.0) * self.counts.ravel()[pairs]
        rows.data *= np.repeat(scale, np.diff(rows.indptr)) * known[rows.indices]
        rows.eliminate_zeros()
        lengths = np.zeros(enough.size + 1, dtype=rows.indptr.dtype)
        lengths[pairs + 1] = np.diff(rows.indptr)
        parts = rows.data, rows.indices, np.cumsum(lengths, dtype=lengths.dtype)
        reward = np.zeros(enough.shape)
        reward[enough] = self._reward[enough] / self.counts[enough]
        joined = csr_array(parts, shape=self._rows.shape)
        return MultiTimeModel(self.names, reward.T, enough.T, joined)


def samples_of(steps: Sequence[tuple[Any, ...]], gamma: float) -> Samples:
    """
    Return every suffix of every run, in one backward pass.

    :param steps: steps of N games, (N,) each: abstract state, model of the option, whether it is
        sampled, reward, whether the run ended, whether the task is over, next abstract state.
    """
    state, option, sampled, reward, ended, over, successor = map(np.array, zip(*steps))
    discount = np.where(over, 0.0, gamma)
    for t in range(len(reward) - 2, -1, -1):
        on = ~ended[t]
        reward[t] += np.where(on, gamma * reward[t + 1], 0.0)
        discount[t] = np.where(on, gamma * discount[t + 1], discount[t])
        successor[t] = np.where(on, successor[t + 1], successor[t])
    return Samples(*(part[sampled] for part in (state, option, reward, discount, successor)))


class Sampler:
    """N games that continue from round to round, with their runs counted as samples."""

    def __init__(
        self,
        actions: ActionSet,
        counts: SampleCounts,
        n_games: int,
        gamma: float,
        rng: np.random.Generator,
        unstick: bool = False,
    ) -> None:
        """
        Begin games at the start of the task.

        :param unstick: whether runs that repeat themselves take random moves.
        """
        self._unstick = unstick
        self._actions, self._counts, self._gamma, self._rng = actions, counts, gamma, rng
        self._limit = actions.domain.max_steps or np.iinfo(np.intp).max
        self._games = new_games(simulated(actions.domain, 'sampling'), n_games, rng)
        self._seen = actions.see(self._games)
        self._age = np.zeros(n_games, dtype=np.intp)

    def play(
        self, policy: Policy[Observation], steps: int, on_steps: Callable[[int], object]
    ) -> int:
        """
        Continue the games with a policy, and count the runs.

        :param steps: total number of game steps, rounded down to a multiple of N.
        :param on_steps: called with the number of game steps so far.
        :return: number of game steps taken.
        """
        n_games = len(self._age)
        left, done = steps // n_games, 0
        while left:
            loops = self._actions.loops(n_games, self._rng) if self._unstick else None
            execution, recorded = Execution(self._actions, policy, n_games, loops=loops), []
            for _ in range(min(left, max(BLOCK // n_games, 1))):
                recorded.append(self._step(execution))
                done += n_games
                on_steps(done)
            self._counts.add(samples_of(recorded, self._gamma))
            left -= len(recorded)
        return done

    def _step(self, execution: Execution[Observation]) -> tuple[Any, ...]:
        """
        Take one step in every game, and restart those that are over or cut off.

        :return: an element of ``steps`` in ``samples_of``.
        """
        fallback, before = self._actions.first_fallback, self._seen
        actions = execution.act(before)
        inside, option = before.can_start(execution.option), execution.option.copy()
        steps = self._games.step(actions, self._rng)
        self._age += 1
        cut_off = self._age >= self._limit
        last = steps.over | cut_off
        left = self._actions.see(self._games) if (cut_off & ~steps.over).any() else None
        if last.any():
            self._games.reset(np.flatnonzero(last), self._rng)
            self._age[last] = 0
        self._seen = self._actions.see(self._games)
        rows = None if execution.loops is None else self._games.features()
        execution.observe(self._seen, steps, cut_off, rows)
        model = np.where(inside, option, option + fallback)
        # The successor is irrelevant if a game is over.
        after, ended = (left or self._seen).states, execution.option == NONE
        return before.states, model, option < fallback, steps.reward, ended, steps.over, after
