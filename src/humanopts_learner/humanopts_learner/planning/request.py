"""Requests for a plan: action sets, settings, and the options to plan with."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
import math
from typing import Any, Protocol

from humanopts_env.domains.base import ActableDomain, is_enumerable
from humanopts_env.domains.replayed_domain import ReplayedDomain
from humanopts_learner.demonstrations import MACHINE
from humanopts_learner.library import no_options_text
from humanopts_learner.options.learned_option import LearnedOption, OptionError

HUMAN, PRIMITIVE, HUMAN_AND_PRIMITIVE = 'human', 'primitive', 'human+primitive'
AUTOMATIC, AUTOMATIC_AND_PRIMITIVE = 'automatic', 'automatic+primitive'
ACTION_SETS = (HUMAN, PRIMITIVE, HUMAN_AND_PRIMITIVE, AUTOMATIC, AUTOMATIC_AND_PRIMITIVE)
OPTIONS_ONLY = (HUMAN, AUTOMATIC)  # primitive actions only if no option can start
OF_MACHINES = (AUTOMATIC, AUTOMATIC_AND_PRIMITIVE)  # sets of automatic options

Q = 'q'  # learning: values by SMDP Q-learning, instead of models

TOLERANCE, SAMPLED_TOLERANCE = 1e-8, 1e-3  # reward units
MAX_SWEEPS = 10_000
GAME_STEPS, REPLAYED_STEPS = 800_000, 10_000  # the latter for worlds that step one at a time

Clock = Callable[[], float]  # seconds


class PlanError(ValueError):
    """A plan cannot be made; the message says why."""


class NoOptionsError(PlanError):
    """The action set needs options, but there are none."""


class PlanCanceled(Exception):  # noqa: N818 - not an error: raised by a progress callback to stop
    """Planning was canceled."""


class Progress(Protocol):
    """Called with the progress of planning; raise ``PlanCanceled`` to stop it."""

    def __call__(self, stage: str, fraction: float, sweeps: int, residual: float, /) -> object:
        """
        Receive the progress.

        :param stage: tables, models, sweeps or evaluation.
        :param fraction: completed fraction of the stage, 0..1.
        :param residual: residual of the last sweep, reward units; NaN before the first.
        """


def ignore_progress(stage: str, fraction: float, sweeps: int, residual: float) -> None:
    """Do nothing."""


class Arbitration(StrEnum):
    """
    Execution of a policy over options; all but the first decide again before each step.

    Commands and messages call it the execution of a plan.
    """

    RUN_TO_END = 'run_to_end'
    """A chosen option runs until it ends."""

    INTERRUPTED = 'interrupted'
    """
    An option is stopped where continuing is worth less than choosing again, both by the values
    of the policy that runs to the end (Sutton, Precup and Singh 1999, section 4).
    """

    MODULAR_MASS = 'modular_mass'
    """
    In every step all options that can start want their action as modules, and the greatest mass
    wins: the action with the greatest sum of strengths (Karlsson 1997, "greatest mass"; Humphrys
    1997, "maximise the collective happiness"). A module's strength is by how much its option is
    worth more than that of the weakest one.
    """

    MODULAR_STRONGEST = 'modular_strongest'
    """
    In every step the strongest module wins: the option of which going on is worth the most, inside
    its initiation set or not (Humphrys 1997, "maximise the best happiness"). Exact values make
    this as safe as interruption, by the same theorem.
    """


MODULAR = (Arbitration.MODULAR_MASS, Arbitration.MODULAR_STRONGEST)


@dataclass(frozen=True)
class Sampling:
    """
    Settings for sampling, and for planning from samples.

    :raises PlanError: a number is out of range.
    """

    rounds: int = 8  # rounds of play; all but the first follow the current policy
    n_games: int = 1000  # maximum number of parallel games
    game_steps: int = 400  # minimum number of steps per game in total
    explore: float = 0.2  # share of random decisions after the first round
    min_samples: int = 1  # required for a pair of state and option to be available
    interruption_margin: float = 10.0  # minimum gain for stopping an option, reward units

    def __post_init__(self) -> None:
        if min(self.rounds - 1, self.n_games, self.min_samples) < 1:
            raise PlanError(f'{self} needs at least two rounds, one game and one sample')
        if self.game_steps < self.rounds:
            raise PlanError(f'{self} needs at least one step of each game in every round')
        if not (0.0 <= self.explore <= 1.0 and 0.0 <= self.interruption_margin < math.inf):
            raise PlanError(f'{self} needs explore from 0 to 1, and a finite margin, 0 or more')


@dataclass(frozen=True)
class PlanRequest:
    """
    Settings of a plan; a number of 0 means the default.

    :raises PlanError: a setting is out of range.
    """

    action_set: str  # one of ``ACTION_SETS``
    gamma: float = 0.0  # discount per primitive step; default: the domain's own
    tol: float = 0.0  # tolerance of the residual, reward units; default: 1e-8 exact, 1e-3 sampled
    max_sweeps: int = 0  # default: 10,000
    game_steps: int = 0  # total sampled; see ``usual_game_steps``; always 0 for exact models
    seed: int = 0  # random seed of the samples
    sampling: Sampling = Sampling()
    columns: tuple[str, ...] = ()  # feature columns of abstract states, as in ``Abstraction``
    unstick: bool = True  # whether sampled runs that repeat themselves take random moves
    execution: Arbitration = Arbitration.RUN_TO_END
    """
    How the policy so far is executed while sampling, from the second round on. Where options are
    interrupted, the models are of interrupted options (Sutton, Precup and Singh 1999, section 4:
    interrupted options can be interrupted again).
    """

    def __post_init__(self) -> None:
        if self.action_set not in ACTION_SETS:
            raise PlanError(
                f'unknown action set {self.action_set!r}; choose from {", ".join(ACTION_SETS)}'
            )
        if self.gamma and not 0.0 < self.gamma <= 1.0:
            raise PlanError(f'gamma is {self.gamma}, but must be above 0 and at most 1')
        check_limits(self.tol, self.max_sweeps or 1)

    def resolved(
        self, domain: ActableDomain, options: Sequence[Any], *, sampled: bool | None = None
    ) -> 'PlanRequest':
        """
        Check the request for a domain and its options; return it with defaults filled in.

        :param options: named options, such as learned ones; ignored in the set ``primitive``.
        :param sampled: whether models are sampled; None: only if the states cannot all be listed.
        :raises PlanError: the plan cannot be made.
        :raises NoOptionsError: the action set needs options, but there are none.
        """
        if sampled is None:
            sampled = not is_enumerable(domain)
        asked = replace(
            self,
            gamma=self.gamma or domain.gamma,
            tol=self.tol or (SAMPLED_TOLERANCE if sampled else TOLERANCE),
            max_sweeps=self.max_sweeps or MAX_SWEEPS,
            game_steps=(self.game_steps or usual_game_steps(domain)) if sampled else 0,
        )
        if self.action_set != PRIMITIVE:
            if not options:
                way = 'extract them' if self.action_set in OF_MACHINES else 'teach one'
                lacking = f'the action set {self.action_set} needs options, but there are none'
                raise NoOptionsError(f'{lacking}: {way} first')
            counts = Counter(option.name for option in options)
            twice = sorted(name for name, count in counts.items() if count > 1)
            if twice:
                raise PlanError(f'more than one option is called {", ".join(twice)}')
            for option in options:
                if isinstance(option, LearnedOption):
                    try:
                        option.check_domain(domain)
                    except OptionError as error:
                        raise PlanError(str(error)) from error
        if sampled:
            fewest = self.sampling.game_steps
            if asked.game_steps < fewest:
                raise PlanError(f'game_steps is {asked.game_steps}, but must be at least {fewest}')
        return asked


def usual_game_steps(domain: ActableDomain) -> int:
    """Return a number of game steps that can be sampled in a few seconds."""
    return REPLAYED_STEPS if isinstance(domain, ReplayedDomain) else GAME_STEPS


def check_limits(tol: float, max_sweeps: int) -> None:
    """
    Check the limits of value iteration.

    :raises PlanError: tol is negative or NaN, or max_sweeps is below 1.
    """
    if not tol >= 0.0 or max_sweeps < 1:
        raise PlanError(f'tol is {tol} and max_sweeps {max_sweeps}: need tol >= 0 and a sweep')


def select_options(
    options: Sequence[LearnedOption],
    action_set: str,
    participant: str = '',
    names: Sequence[str] = (),
) -> list[LearnedOption]:
    """
    Select the options to plan with, in the given order; none for the set ``primitive``.

    The ``automatic`` sets use options of participants with codes that begin with ``MACHINE``, and
    the ``human`` sets use those of all others.

    :param participant: participant who taught the options; empty: the only one.
    :param names: names of the options to plan with; empty: all.
    :raises PlanError: no participant is given and there are several, or a name is unknown.
    :raises NoOptionsError: the participant has no options, but others do.
    """
    if action_set == PRIMITIVE:
        return []
    machine = action_set in OF_MACHINES
    kind = [option for option in options if option.participant.startswith(MACHINE) == machine]
    people = sorted({option.participant for option in kind})
    if not participant and len(people) > 1:
        raise PlanError(f'options belong to several participants: name one of {", ".join(people)}')
    theirs = [option for option in kind if participant in ('', option.participant)]
    if people and not theirs:
        raise NoOptionsError(no_options_text(participant, people))
    known = [option.name for option in theirs]
    unknown = [repr(name) for name in names if name not in known]
    if known and unknown:
        raise PlanError(
            f'no option {", ".join(unknown)}; choose from {", ".join(map(repr, known))}'
        )
    return [option for option in theirs if not names or option.name in names]
