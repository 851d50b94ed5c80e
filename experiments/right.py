"""
Check whether a learned option is right, that is, behaves as its teacher meant.

An option is *right from a start* if it can start there and its run ends in the first state in
which the teacher's run would end, with the end that the teacher meant, within ``SLOWER`` times the
teacher's steps. An option is *right* if it is right from at least ``SHARE`` of the starts of its
reference option. The share of other states in which it can start is measured as well.

In a domain with chance, the probability of such a run must be at least ``SHARE`` of that of the
teacher's runs, and its mean number of steps at most ``SLOWER`` times the teacher's. A run may
continue at an end that only chance leads to. Where all states can be listed, both numbers are
computed exactly from the transitions, for every start. In Pac-Man, the probability is the share in
``RUNS`` runs from each of ``STARTS`` sampled starts, with the same random numbers as the teacher's
runs. No run may be longer than ``SLOWER`` times the teacher's longest right run from there. A
start counts as wrong if the difference is significant (McNemar 1947, one-sided, 5 %), and the mean
share over the right starts must be at least ``SHARE`` of the teacher's. In a replayed environment,
the seed of a start determines the run, and the starts are those that the teacher reaches after
resets.
"""

from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import IntEnum
from itertools import compress
from typing import Any, Protocol

from humanopts_env.arrays import Flags, Floats, Ints
from humanopts_env.domains.base import Domain, EnumerableDomain, is_enumerable
from humanopts_env.domains.gymnasium_reference import WatchedOption
from humanopts_env.domains.pacman.games import PacManGames
from humanopts_env.domains.pacman.reference import PacManOption
from humanopts_env.domains.reference import (
    judge_games,
    ReferenceOption,
    StartDependent,
    TabularReferenceOption,
)
from humanopts_env.domains.replayed_domain import ReplayedDomain
from humanopts_env.domains.tabular import reachable
from humanopts_env.games import feature_rows, Games, games_at, StateGames
from humanopts_env.seeding import generator
from humanopts_learner.option import Option
from humanopts_learner.options.learned_option import TabularOption, tabulate
import numpy as np

from experiments.worlds import starts_of

SHARE = 0.95
SLOWER = 2.0
STARTS, RUNS = 200, 20
REPLAYED = 100  # starts in a replayed environment
ONE_SIDED = 1.645  # standard errors that chance exceeds in 5 of 100 cases
NAME = 'right'  # key of random draws
LONGEST = 1000  # maximum steps of a teacher's run if the domain has no limit


class Ending(IntEnum):
    """The way in which a run of an option ends."""

    RIGHT = 0  # where the teacher ends, as meant
    EARLY = 1  # where the teacher would continue
    LATE = 2  # the option continued where the teacher would have ended
    OTHER = 3  # where the teacher would end too, but not as meant, or the task is over
    NEVER = 4  # not within its step limit


ON = -1  # the run continues


@dataclass(frozen=True)
class Performance:
    """The runs of an option from N starts of its reference option."""

    can_start: Flags  # (N,)
    endings: Floats  # (N, E) share of the runs with each ``Ending``
    steps: Floats  # (N,) number of steps of right runs: mean, or maximum in a sample; NaN: none
    doubt: Floats | float = 0.0  # (N,) difference from the teacher that chance can explain
    elsewhere: float = 0.0  # share of other states in which it can start

    def right(self, teacher: 'Performance') -> Flags:
        """Return (N,) whether the option is right from each start, given the teacher's runs."""
        often = self.share + self.doubt >= SHARE * teacher.share
        return self.can_start & often & (self.steps <= SLOWER * teacher.steps)

    def is_right(self, teacher: 'Performance') -> bool:
        """Return whether the option is right."""
        right = self.right(teacher)
        enough = self.share[right].sum() >= SHARE * teacher.share[right].sum()
        return bool(right.mean() >= SHARE and enough)

    @property
    def share(self) -> Floats:
        """(N,) share of right runs."""
        return self.endings[:, Ending.RIGHT]

    def faults(self, teacher: 'Performance') -> dict[str, float]:
        """Return the share of starts with each fault; right starts have none."""
        right = self.right(teacher)
        names = np.array(['refused', 'slow', *(each.name.lower() for each in Ending)])
        worst = 2 + self.endings[:, 1:].argmax(axis=1) + 1
        slow = ~(self.steps > SLOWER * teacher.steps)
        fault = np.where(~self.can_start, 0, np.where(slow, worst, 1))[~right]
        found, count = np.unique(names[fault], return_counts=True)
        return {str(name): float(n / len(right)) for name, n in zip(found, count)}


def ending_of(ends: Flags, over: Flags, meant_ends: Flags, reached: Flags) -> Ints:
    """
    Return (N,) the ``Ending`` of N runs after a step, or ``ON`` if a run continues.

    :param ends: (N,) whether the option ends in the state reached.
    :param over: (N,) whether the task is over.
    :param meant_ends: (N,) whether the teacher ends there.
    :param reached: (N,) whether the teacher ends there as meant.
    """
    stops = ends | over
    found = np.full(len(ends), ON)
    found[stops & ~meant_ends] = Ending.EARLY
    found[~stops & meant_ends] = Ending.LATE
    found[(stops & meant_ends) | over] = Ending.OTHER
    found[stops & reached] = Ending.RIGHT
    return found


# Enumerable domains.


def chain(
    domain: EnumerableDomain, option: TabularOption, reference: TabularReferenceOption
) -> Performance:
    """Return the exact performance from each of S states, by recursion over the steps left."""
    table, over, states = domain.transitions(), domain.over(), np.arange(domain.n_states)
    ending = ending_of(option.termination, over, reference.termination, reference.goal)
    if not table.deterministic:  # where chance led to another end, continuing may be as good
        ending[(ending == Ending.LATE) & ~reference.goal] = ON
    successor, chance = (
        part[states, option.action].astype(kind)
        for part, kind in ((table.successor, np.intp), (table.probability, float))
    )
    ended = np.zeros((domain.n_states, len(Ending)))  # of runs that have just reached a state
    ended[np.flatnonzero(ending != ON), ending[ending != ON]] = 1.0
    on = (ending == ON)[:, None]
    shares, total = np.zeros_like(ended), np.zeros(domain.n_states)
    for _ in range(option.max_steps):
        after = ended + on * shares  # within the remaining steps
        new = np.einsum('sb,sbe->se', chance, after[successor])
        later = (total + shares[:, Ending.RIGHT]) * on[:, 0] + ended[:, Ending.RIGHT]
        new_total = (chance * later[successor]).sum(axis=1)
        if np.array_equal(new, shares) and np.array_equal(new_total, total):
            break
        shares, total = new, new_total
    shares[:, Ending.NEVER] = 1.0 - shares.sum(axis=1)
    with np.errstate(invalid='ignore', divide='ignore'):
        steps = np.where(shares[:, Ending.RIGHT] > 0, total / shares[:, Ending.RIGHT], np.nan)
    return Performance(option.initiation, shares, steps)


class Meant(Protocol):
    """An option of a domain, as its teacher means it."""

    teacher: Performance  # the teacher's own

    def performance(self, option: Option) -> Performance:
        """Run an option from the same starts."""


class MeantEverywhere:
    """An option of an enumerable domain, as its teacher means it."""

    def __init__(
        self, domain: EnumerableDomain, reference: TabularReferenceOption | StartDependent
    ) -> None:
        """Run the teacher from every state that an episode can reach."""
        self._domain, self._others = domain, reachable(domain) & ~domain.over()
        starts: dict[TabularReferenceOption, list[int]] = defaultdict(list)
        for state in np.flatnonzero(self._others).tolist():
            meant: Any = reference
            if isinstance(reference, StartDependent):
                meant = reference.begun(domain.state_at(state))
            if meant.initiation[state]:
                starts[meant].append(state)
        self._starts = {meant: np.array(states) for meant, states in starts.items()}
        self._others[np.concatenate([*self._starts.values()])] = False
        longest = domain.max_steps or LONGEST
        self.teacher = self._run(lambda meant: TabularOption.of_reference(meant, longest))

    def performance(self, option: Option) -> Performance:
        table = tabulate(option, self._domain)
        found, elsewhere = self._run(lambda meant: table), table.initiation[self._others]
        return replace(found, elsewhere=float(elsewhere.mean()) if elsewhere.size else 0.0)

    def _run(self, option: Callable[[TabularReferenceOption], TabularOption]) -> Performance:
        runs = [
            (chain(self._domain, option(meant), meant), states)
            for meant, states in self._starts.items()
        ]
        return Performance(
            np.concatenate([run.can_start[states] for run, states in runs]),
            np.concatenate([run.endings[states] for run, states in runs]),
            np.concatenate([run.steps[states] for run, states in runs]),
        )


# Other domains.


class MeantInSample:
    """An option of another domain, as its teacher means it, from a sample of starts."""

    def __init__(
        self, domain: Domain, references: Mapping[str, ReferenceOption], name: str, seed: int
    ) -> None:
        """Draw the starts, and run the teacher from each."""
        self._domain, self._reference, self._seed = domain, references[name], seed
        self._starts, self._others = list[Any](), list[Any]()
        self._replayed, self._runs = isinstance(domain, ReplayedDomain), 1
        if self._replayed:
            steps = list[float]()
            for each in references:
                for state, taken in starts_of(domain, each, seed, REPLAYED):
                    if each == name and taken:
                        self._starts.append(state)
                        steps.append(taken)
                    elif not self._reference.can_start(state):
                        self._others.append(state)
            endings = np.zeros((len(steps), len(Ending)))
            endings[:, Ending.RIGHT] = 1.0
            self.teacher = Performance(np.ones(len(steps), bool), endings, np.array(steps))
            self._limits: Ints = (SLOWER * self.teacher.steps).astype(np.intp)
            self._teacher_right = np.ones((1, len(steps)), bool)
            return
        rng, self._runs = generator(seed, NAME, name), RUNS
        while len(self._starts) < STARTS:
            states = domain.sample_states(rng, STARTS)
            can_start = judge_games(self._reference, games_at(domain, states)).initiation
            for state, can in zip(states, can_start):
                (self._starts if can else self._others).append(state)
        self._limits = np.full(len(self._starts), domain.max_steps or LONGEST)
        ending, steps_taken = self._play(
            lambda games: judge_games(self._reference, games).optimal.argmax(axis=1),
            lambda games: _ends(self._reference, games)[0],
        )
        sure = (ending == Ending.RIGHT).any(axis=0)  # from the other starts even the teacher fails
        self._starts = list(compress(self._starts, sure))
        ending, steps_taken = ending[:, sure], steps_taken[:, sure]
        self.teacher = _summary(np.ones(len(self._starts), bool), ending, steps_taken)
        self._teacher_right = ending == Ending.RIGHT
        self._limits = (SLOWER * self.teacher.steps).astype(np.intp)

    def performance(self, option: Option) -> Performance:
        can_start = option.can_start(feature_rows(self._domain, self._starts))
        played = self._play(
            lambda games: option.action(games.features()),
            lambda games: option.ends(games.features()),
        )
        found = _summary(can_start, *played)
        differs = (played[0] == Ending.RIGHT) != self._teacher_right
        doubt = ONE_SIDED * np.sqrt(differs.sum(axis=0)) / self._runs if self._runs > 1 else 0.0
        found = replace(found, doubt=doubt)
        if not self._others:
            return found
        elsewhere = option.can_start(feature_rows(self._domain, self._others))
        return replace(found, elsewhere=float(elsewhere.mean()))

    def _play(
        self, act: Callable[[Games], Ints], ends: Callable[[Games], Flags]
    ) -> tuple[Ints, Ints]:
        """Return the ending and the steps of R runs from each of N starts, (R, N) each."""
        states, limits = self._starts * self._runs, np.tile(self._limits, self._runs)
        # For a replayed domain, games_at does not keep the worlds that the reference option needs.
        games: Games = (
            StateGames(self._domain, states) if self._replayed else games_at(self._domain, states)
        )
        playing = np.arange(len(states))
        chance = [generator(self._seed, NAME, run) for run in playing.tolist()]
        ending, steps = np.full(len(states), Ending.NEVER), np.zeros(len(states), dtype=np.intp)
        while len(playing):
            games.step(act(games), [chance[run] for run in playing.tolist()])
            steps[playing] += 1
            found = ending_of(ends(games), games.over(), *_ends(self._reference, games))
            ending[playing[found != ON]] = found[found != ON]
            on = np.flatnonzero((found == ON) & (steps[playing] < limits[playing]))
            games, playing = games.take(on), playing[on]
        shape = self._runs, len(self._starts)
        return ending.reshape(shape), steps.reshape(shape)


def _summary(can_start: Flags, ending: Ints, steps: Ints) -> Performance:
    """
    Return the performance in R runs from each of N starts.

    :param ending: (R, N) ``Ending`` of each run.
    :param steps: (R, N) number of steps of each run.
    """
    right = ending == Ending.RIGHT
    endings = np.stack([(ending == each).mean(axis=0) for each in Ending], axis=1)
    longest = np.where(right.any(axis=0), np.where(right, steps, 0).max(axis=0), np.nan)
    return Performance(can_start, endings, longest)


def _ends(reference: ReferenceOption, games: Games) -> tuple[Flags, Flags]:
    """Return whether the teacher ends in each game, and whether as meant, (N,) each."""
    if isinstance(reference, PacManOption):
        assert isinstance(games, PacManGames)
        return reference.judge(games.batch).termination, reference.goal(games.batch)
    assert isinstance(reference, WatchedOption)
    reached = np.array([reference.reached(state) for state in games.states()], dtype=np.bool_)
    return reached | games.over(), reached


def meant(domain: Domain, references: dict[str, ReferenceOption], name: str, seed: int) -> Meant:
    """Return an option as its teacher means it."""
    reference = references[name]
    if is_enumerable(domain):
        assert isinstance(reference, TabularReferenceOption | StartDependent)
        return MeantEverywhere(domain, reference)
    return MeantInSample(domain, references, name, seed)
