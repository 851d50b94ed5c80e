"""
Execution of options in N games: the only code that decides when options start and end.

``Execution`` implements the rules of a run; the live runner uses it with one game. ``play`` is the
loop around it: rollouts, held-out returns, accuracy, start states and evaluation call it with
different options and policies.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, Generic, Protocol, Self, TypeVar

from humanopts_env.arrays import Flags, Floats, Ints, Rows
from humanopts_env.games import Chance, chance_of, Games, Steps
from humanopts_env.option import runs_end
from humanopts_learner.option import Option
import numpy as np
from numpy.typing import NDArray

NONE = -1  # no option running: a choice is due


class Seen(Protocol):
    """An observation of N games, with the decisions of options in it."""

    def take(self, games: Ints) -> Self:
        """Return the observation of the selected games (M,)."""

    def action(self, option: Ints) -> Ints:
        """Return (N,): the primitive action of each game's option (N,)."""

    def ends(self, option: Ints) -> Flags:
        """Return (N,): whether each game's option (N,) ends."""


S = TypeVar('S', bound=Seen)
S_in = TypeVar('S_in', bound=Seen, contravariant=True)
S_out = TypeVar('S_out', bound=Seen, covariant=True)


class Options(Protocol[S_out]):
    """O options of one domain, by index."""

    @property
    def limits(self) -> Ints:
        """(O,) maximum number of steps per run of each option."""

    def see(self, games: Games) -> S_out:
        """Observe games."""


class Policy(Protocol[S_in]):
    """Chooses the options to run."""

    def choose(self, seen: S_in, games: Ints) -> Ints:
        """
        Return (N,): the next option in the given games.

        :param games: (N,) game numbers.
        """

    def stops(self, seen: S_in, option: Ints) -> Flags | None:
        """Return (N,): whether each game's option (N,) is stopped; None: none are."""
        return None


def draw_among(among: Flags, rng: np.random.Generator) -> Ints:
    """Return the index (N,) of a uniformly random True entry of each row (N, O)."""
    chosen: Ints = np.where(among, rng.random(among.shape), -1.0).argmax(axis=1)
    return chosen


@dataclass(frozen=True)
class Fixed(Policy[Seen]):
    """A policy that always runs the same option in each game."""

    option: Ints  # (N,) of each game

    def choose(self, seen: Seen, games: Ints) -> Ints:
        return self.option.take(games)


@dataclass(frozen=True)
class Runs:
    """R runs of options in N games, in order of completion."""

    game: Ints  # (R,)
    option: Ints  # (R,)
    begun: Ints  # (R,) game step at which the run began
    steps: Ints  # (R,) length of the run, k
    total: Floats  # (R,) sum of r[i], i = 0..k-1
    discounted: Floats  # (R,) sum of gamma**i * r[i]
    reached: Flags  # (R,) the termination condition holds
    over: Flags  # (R,) the task is over
    stopped: Flags  # (R,) the policy stopped it


class Execution(Generic[S]):
    """
    Runs one option at a time in each of N games.

    A run ends when the termination condition holds, which is checked only after a step; when the
    task is over; after ``max_steps``; or when the policy stops it.

    :ivar games: (N,) game numbers.
    :ivar option: (N,) indices of the running options; ``NONE``: a choice is due.
    :ivar decided: (M,) indices among the N games of the latest choices.
    :ivar total: (N,) sum of r[i] of the newest run of each game.
    :ivar discounted: (N,) sum of gamma**i * r[i] of the newest run of each game.
    """

    def __init__(
        self,
        options: Options[S],
        policy: Policy[S],
        count: int,
        gamma: float = 1.0,
        limits: Ints | None = None,
    ) -> None:
        """
        Start with no option running.

        :param count: number of games, N.
        :param gamma: discount per primitive step.
        :param limits: (N,) maximum number of steps per run in each game; None: the options' own.
        """
        self.policy, self._gamma = policy, gamma
        self._of_option, self._of_game = options.limits, limits
        self.games = self.decided = np.arange(count)
        self.option = np.full(count, NONE, dtype=np.intp)
        self._ran, self._age = np.zeros((2, count), dtype=np.intp)
        self.total, self.discounted = np.zeros((2, count))

    def act(self, seen: S) -> Ints:
        """Return the primitive actions (N,), choosing options first where a choice is due."""
        self.decided = due = np.flatnonzero(self.option == NONE)
        if due.size:
            among = seen if len(due) == len(self.option) else seen.take(due)
            self.option[due] = self.policy.choose(among, self.games.take(due))
            self._ran[due], self.total[due], self.discounted[due] = 0, 0.0, 0.0
        return seen.action(self.option)

    def observe(self, seen: S, steps: Steps, cut_off: Flags | bool = False) -> Runs:
        """
        Record the outcome of the actions, and return the runs that ended.

        :param seen: observation after the step.
        :param cut_off: (N,) whether each game ends here for another reason.
        """
        self.total += steps.reward
        self.discounted += self._gamma**self._ran * steps.reward
        self._ran += 1
        self._age += 1
        reached = seen.ends(self.option)
        limits = self._of_option.take(self.option) if self._of_game is None else self._of_game
        ended = runs_end(reached, steps.over | cut_off, self._ran, limits)
        stopped = self.policy.stops(seen, self.option)
        stopped = np.zeros_like(ended) if stopped is None else stopped & ~ended
        at = np.flatnonzero(ended | stopped)
        runs = Runs(
            self.games.take(at),
            self.option.take(at),
            (self._age - self._ran).take(at),
            self._ran.take(at),
            self.total.take(at),
            self.discounted.take(at),
            reached.take(at),
            steps.over.take(at),
            stopped.take(at),
        )
        self.option[at] = NONE
        return runs

    def keep(self, chosen: Ints) -> None:
        """Keep only the selected games (M,)."""
        self.games, self.option = self.games.take(chosen), self.option.take(chosen)
        self._ran, self._age = self._ran.take(chosen), self._age.take(chosen)
        self.total = self.total.take(chosen)
        self.discounted = self.discounted.take(chosen)
        if self._of_game is not None:
            self._of_game = self._of_game.take(chosen)


@dataclass(frozen=True)
class Played:
    """The runs and outcomes of N games."""

    over: Flags  # (N,) task over; otherwise the game was cut off
    runs: Runs
    outcomes: Mapping[str, NDArray[Any]]  # (N,) each, as ``Games.outcomes``

    def by_game(self, values: Any) -> Floats:
        """Return (N,): the sum of values (R,) over the runs of each game."""
        weights = np.asarray(values, dtype=np.float64)
        found: Floats = np.bincount(self.runs.game, weights, minlength=len(self.over)).astype(
            float
        )
        return found


def play(
    games: Games,
    options: Options[S],
    policy: Policy[S],
    chance: Chance,
    max_steps: int,
    *,
    gamma: float = 1.0,
    limits: Ints | None = None,
    once: bool = False,
    on_step: Callable[[int, Execution[S], S], object] | None = None,
) -> Played:
    """
    Play games by a policy until each is over.

    :param games: N games, modified in place; those already over have no runs.
    :param chance: random draws of the steps; one generator per game makes games independent.
    :param max_steps: maximum number of steps per game.
    :param gamma: discount per primitive step.
    :param limits: (N,) maximum number of steps per run in each game; None: the options' own.
    :param once: end each game with its first run.
    :param on_step: called in every step, after the choices, with the step number; its exceptions
        propagate.
    """
    outcomes = {name: values.copy() for name, values in games.outcomes().items()}
    execution, parts = Execution(options, policy, len(games), gamma, limits), []
    done = games.over()
    over = done.copy()
    seen = options.see(games)
    for step in range(max_steps):
        if done.any():
            for name, values in games.outcomes().items():
                outcomes[name][execution.games] = values
            on = np.flatnonzero(~done)
            games, seen, chance = games.take(on), seen.take(on), chance_of(chance, on)
            execution.keep(on)
        if not execution.games.size:
            break
        actions = execution.act(seen)
        if on_step is not None:
            on_step(step, execution, seen)
        steps = games.step(actions, chance)
        seen = options.see(games)
        parts.append(execution.observe(seen, steps, step + 1 == max_steps))
        over[execution.games] = steps.over
        done = steps.over | (execution.option == NONE) if once else steps.over
    for name, values in games.outcomes().items():
        outcomes[name][execution.games] = values
    return Played(over, joined(parts), outcomes)


def joined(parts: Sequence[Runs]) -> Runs:
    """Concatenate the runs that ended in several steps."""
    none: Any = np.zeros(0, dtype=np.intp)
    return Runs(
        *(
            np.concatenate([getattr(part, field.name) for part in parts]) if parts else none
            for field in fields(Runs)
        )
    )


class RowOptions:
    """Options evaluated on demand on the features of games."""

    def __init__(self, options: Sequence[Option]) -> None:
        self.options = tuple(options)
        self.limits = np.array([option.max_steps for option in options], dtype=np.intp)

    def see(self, games: Games) -> 'SeenRows':
        return SeenRows(self.options, games.features())


@dataclass(frozen=True)
class SeenRows:
    """The features of N games, with the decisions of options on them."""

    options: Sequence[Option]
    rows: Rows  # (N, F)

    def take(self, games: Ints) -> 'SeenRows':
        return SeenRows(self.options, self.rows.take(games, axis=0))

    def action(self, option: Ints) -> Ints:
        return self._each(option, lambda one, rows: one.action(rows)).astype(np.intp)

    def ends(self, option: Ints) -> Flags:
        return self._each(option, lambda one, rows: one.ends(rows)).astype(np.bool_)

    @cached_property
    def startable(self) -> Flags:
        """(N, O) whether each option can start."""
        return np.stack([option.can_start(self.rows) for option in self.options], axis=1)

    def _each(self, option: Ints, answer: Callable[[Option, Rows], NDArray[Any]]) -> NDArray[Any]:
        found = np.zeros(len(option), dtype=np.intp)
        for index, one in enumerate(self.options):
            at = np.flatnonzero(option == index)
            if len(at) == len(option):
                return answer(one, self.rows)
            if at.size:
                found[at] = answer(one, self.rows.take(at, axis=0))
        return found
