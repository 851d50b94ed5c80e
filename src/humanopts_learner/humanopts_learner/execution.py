"""
Execution of options in N games: the only code that decides when options start and end.

``Execution`` implements the rules of a run; the live runner uses it with one game. ``play`` is the
loop around it: rollouts, held-out returns, accuracy, start states and evaluation call it with
different options and policies.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, Generic, Protocol, Self, TypeVar

from humanopts_env.arrays import Flags, Floats, Ints, Rows
from humanopts_env.domains.base import ActableDomain, FeatureKind
from humanopts_env.games import Chance, chance_of, Games, Steps
from humanopts_env.option import runs_end
from humanopts_learner.option import Option
import numpy as np
from numpy.typing import NDArray

NONE = -1  # no option running: a choice is due
RANDOM_MOVES = 3  # maximum number of random moves when a run repeats itself; minimum: 1
REPEATED = 2  # a run repeats itself at this multiple of the visits in a demonstration
RESOLUTION = 1000  # number of intervals of a continuous feature; values in one count as equal


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
        Return (N,): the next option in the given games; ``NONE`` ends the game in ``play``.

        :param games: (N,) game numbers.
        """

    def stops(self, seen: S_in, option: Ints) -> Flags | None:
        """Return (N,): whether each game's option (N,) is stopped; None: no option is."""
        return None


def draw_among(among: Flags, rng: np.random.Generator) -> Ints:
    """Return the index (N,) of a uniformly random True entry of each row (N, O)."""
    chosen: Ints = np.where(among, rng.random(among.shape), -1.0).argmax(axis=1)
    return chosen


@dataclass(frozen=True)
class Fixed(Policy[Seen]):
    """A policy that always runs the same option in each game."""

    option: Ints  # (N,) option of each game

    def choose(self, seen: Seen, games: Ints) -> Ints:
        return self.option.take(games)


def looks_of(rows: Rows, domain: ActableDomain) -> list[bytes]:
    """Return one key per row (N, F); rows that look the same have equal keys."""
    continuous = [feature.kind is FeatureKind.CONTINUOUS for feature in domain.features]
    spans = [feature.span for feature in domain.features]
    scale = np.where(continuous, RESOLUTION / np.array(spans), 1.0)
    return [row.tobytes() for row in np.floor(rows * scale).astype(np.int64)]


class Loops:
    """
    Detects runs that repeat themselves, and breaks the repetition with random moves.

    Features need not determine the state: they can stay the same while crossing an open field,
    and recur where chance pushes the agent back. So a run counts as repeating itself when its
    features have looked the same ``REPEATED`` times as often as in any demonstration of its
    option. It then takes 1 to ``RANDOM_MOVES`` random moves and continues.
    """

    def __init__(
        self,
        domain: ActableDomain,
        most_visits: Ints,
        count: int,
        rng: np.random.Generator | None,
    ) -> None:
        """
        Start without runs.

        :param most_visits: (O,) maximum number of rows that look the same in one demonstration
            of each option; 0: its runs are not checked.
        :param count: number of games, N.
        :param rng: generator for the random moves; None: a run that repeats itself ends, and so
            does its game.
        """
        self._domain, self._rng = domain, rng
        self._most = REPEATED * most_visits
        self._visits: list[Counter[bytes]] = [Counter() for _ in range(count)]
        self._left = np.zeros(count, dtype=np.intp)
        self.moves = np.zeros(count, dtype=np.intp)  # (N,) random moves of the newest run
        self.ended = np.zeros(count, dtype=np.bool_)  # (N,) whether the run repeats and ends
        self.stuck = np.full(count, NONE)  # (N,) run length at the first repetition, or NONE

    def begin(self, games: Ints) -> None:
        """Reset games (M,) in which new runs begin."""
        self.moves[games] = self._left[games] = 0
        self.stuck[games] = NONE
        for game in games.tolist():
            self._visits[game].clear()

    def act(self, actions: Ints) -> Ints:
        """Return the actions (N,), replaced by random ones where a run repeats itself."""
        moved = self._left > 0
        if self._rng is None or not moved.any():
            return actions
        self.moves += moved
        self._left -= moved
        drawn = self._rng.integers(len(self._domain.actions), size=len(actions))
        return np.where(moved, drawn, actions)

    def observe(self, rows: Rows, option: Ints, ran: Ints, ended: Flags) -> None:
        """
        Count the visits after a step.

        :param rows: (N, F) features.
        :param option: (N,) options of the runs.
        :param ran: (N,) lengths of the runs.
        :param ended: (N,) whether the runs have already ended.
        """
        most, found = self._most.take(option), np.zeros(len(rows), dtype=np.bool_)
        at = np.flatnonzero((self._left == 0) & (most > 0) & ~ended)
        for game, look in zip(at.tolist(), looks_of(rows.take(at, axis=0), self._domain)):
            visits = self._visits[game]
            visits[look] += 1
            if visits[look] >= most[game]:
                found[game] = True
                visits.clear()
        self.stuck = np.where(found & (self.stuck == NONE), ran, self.stuck)
        if self._rng is None:
            self.ended = found
        else:
            self._left[found] = self._rng.integers(1, RANDOM_MOVES + 1, found.sum())

    def keep(self, chosen: Ints) -> None:
        """Keep only the selected games (M,)."""
        self._left, self.moves = self._left.take(chosen), self.moves.take(chosen)
        self.ended, self.stuck = self.ended.take(chosen), self.stuck.take(chosen)
        self._visits = [self._visits[game] for game in chosen.tolist()]


@dataclass(frozen=True)
class Runs:
    """R runs of options in N games, in order of completion."""

    game: Ints  # (R,)
    option: Ints  # (R,)
    begun: Ints  # (R,) game step at which the run began
    steps: Ints  # (R,) length of the run, k
    total: Floats  # (R,) sum of r[i], i = 0..k-1
    discounted: Floats  # (R,) sum of gamma**i * r[i]
    last_reward: Floats  # (R,) r[k-1]
    reached: Flags  # (R,) the termination condition holds
    over: Flags  # (R,) the task is over
    stopped: Flags  # (R,) the policy stopped it
    random_moves: Ints  # (R,) number taken because the run repeated itself
    stuck: Ints  # (R,) game step at which it first repeated itself; ``NONE``: it did not


class Execution(Generic[S]):
    """
    Runs one option at a time in each of N games.

    A run ends when the termination condition holds, which is checked only after a step; when the
    task is over; after ``max_steps``; or when the policy stops it. With ``Loops``, a run that
    repeats itself takes random moves or ends.

    :ivar games: (N,) game numbers.
    :ivar option: (N,) indices of the running options; ``NONE``: a choice is due.
    :ivar loops: detector of runs that repeat themselves; None: runs are not checked.
    :ivar decided: (M,) positions of the games in which the last ``act`` chose an option.
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
        loops: Loops | None = None,
    ) -> None:
        """
        Start with no option running.

        :param count: number of games, N.
        :param gamma: discount per primitive step.
        :param limits: (N,) maximum number of steps per run in each game; None: the options' own.
        :param loops: as the attribute.
        """
        self.policy, self._gamma, self.loops = policy, gamma, loops
        self._of_option, self._of_game = options.limits, limits
        self.games = self.decided = np.arange(count)
        self.option = np.full(count, NONE, dtype=np.intp)
        self._ran, self._age = np.zeros((2, count), dtype=np.intp)
        self.total, self.discounted = np.zeros((2, count))

    def act(self, seen: S) -> Ints:
        """Return the primitive actions (N,), choosing options first where a choice is due."""
        self.decided = due = (self.option == NONE).nonzero()[0]
        if due.size:
            among = seen if len(due) == len(self.option) else seen.take(due)
            self.option[due] = self.policy.choose(among, self.games.take(due))
            self._ran[due], self.total[due], self.discounted[due] = 0, 0.0, 0.0
            if self.loops is not None:
                self.loops.begin(due)
        actions = seen.action(self.option)
        return actions if self.loops is None else self.loops.act(actions)

    def observe(
        self, seen: S, steps: Steps, cut_off: Flags | bool = False, rows: Rows | None = None
    ) -> Runs:
        """
        Record the outcome of the actions, and return the runs that ended.

        :param seen: observation after the step.
        :param cut_off: (N,) whether each game is cut off after this step.
        :param rows: (N, F) features after the step; needed with ``Loops``.
        """
        self.total += steps.reward
        self.discounted += self._gamma**self._ran * steps.reward
        self._ran += 1
        self._age += 1
        reached = seen.ends(self.option)
        limits = self._of_option.take(self.option) if self._of_game is None else self._of_game
        ended = runs_end(reached, steps.over | cut_off, self._ran, limits)
        stops, loops = self.policy.stops(seen, self.option), self.loops
        done = ended if stops is None else ended | stops
        if loops is not None:
            assert rows is not None
            loops.observe(rows, self.option, self._ran, done)
            done = done | loops.ended
        at = done.nonzero()[0]
        if not at.size:  # the usual case in a live run
            return NO_RUNS
        begun = (self._age - self._ran).take(at)
        stopped = np.zeros(len(at), np.bool_) if stops is None else (stops & ~ended).take(at)
        moves, stuck = np.zeros_like(at), np.full_like(at, NONE)
        if loops is not None:
            moves, stuck = loops.moves.take(at), loops.stuck.take(at)
            stuck = np.where(stuck == NONE, NONE, begun + stuck)
        runs = Runs(
            self.games.take(at),
            self.option.take(at),
            begun,
            self._ran.take(at),
            self.total.take(at),
            self.discounted.take(at),
            steps.reward.take(at),
            reached.take(at),
            steps.over.take(at),
            stopped,
            moves,
            stuck,
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
        if self.loops is not None:
            self.loops.keep(chosen)


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
    loops: Loops | None = None,
    on_step: Callable[[int, Execution[S], S, Games], object] | None = None,
    final: Rows | None = None,
) -> Played:
    """
    Play games with a policy until each is over.

    :param games: N games, modified in place; those already over have no runs.
    :param chance: random draws of the steps; one generator per game makes games independent.
    :param max_steps: maximum number of steps per game.
    :param gamma: discount per primitive step.
    :param limits: (N,) maximum number of steps per run in each game; None: the options' own.
    :param once: whether each game ends with its first run.
    :param loops: detector of runs that repeat themselves; None: runs are not checked.
    :param on_step: called in every step after the choices, with the step number, the execution,
        the observation and the games; its exceptions propagate.
    :param final: (N, F) array to fill with the final features; None: not needed.
    """
    outcomes = {name: values.copy() for name, values in games.outcomes().items()}
    execution, parts = Execution(options, policy, len(games), gamma, limits, loops), []
    done = games.over()
    over = done.copy()
    seen = options.see(games)

    def note() -> None:
        for name, values in games.outcomes().items():
            outcomes[name][execution.games] = values
        if final is not None:
            final[execution.games] = games.features()

    def drop(done: Flags) -> None:
        nonlocal games, seen, chance
        note()
        on = np.flatnonzero(~done)
        games, seen, chance = games.take(on), seen.take(on), chance_of(chance, on)
        execution.keep(on)

    for step in range(max_steps):
        if done.any():
            drop(done)
        if not execution.games.size:
            break
        actions = execution.act(seen)
        if on_step is not None:
            on_step(step, execution, seen, games)
        if (idle := execution.option == NONE).any():
            actions = actions[~idle]
            drop(idle)
        steps = games.step(actions, chance)
        seen = options.see(games)
        rows = games.features() if loops is not None else None
        parts.append(execution.observe(seen, steps, step + 1 == max_steps, rows))
        over[execution.games] = steps.over
        done = steps.over | (execution.option == NONE) if once else steps.over
        if loops is not None:
            done = done | loops.ended
    note()
    return Played(over, joined(parts), outcomes)


def joined(parts: Sequence[Runs]) -> Runs:
    """Concatenate runs that ended in different steps."""
    if not parts:
        return Runs(*(np.zeros(0, bool if f.type == Flags else np.intp) for f in fields(Runs)))
    return Runs(
        *(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(Runs))
    )


NO_RUNS = joined(())


class RowOptions:
    """Options evaluated on demand on the features of games."""

    def __init__(self, options: Sequence[Option]) -> None:
        self.options = tuple(options)
        self.limits = np.array([option.max_steps for option in options], dtype=np.intp)

    def see(self, games: Games) -> 'SeenRows':
        return SeenRows(self.options, games.features())


@dataclass(frozen=True)
class SeenRows:
    """The features of N games, with the decisions of options in them."""

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
        if len(self.options) == 1:
            return answer(self.options[0], self.rows)
        found = np.zeros(len(option), dtype=np.intp)
        for index, one in enumerate(self.options):
            at = np.flatnonzero(option == index)
            if len(at) == len(option):
                return answer(one, self.rows)
            if at.size:
                found[at] = answer(one, self.rows.take(at, axis=0))
        return found
