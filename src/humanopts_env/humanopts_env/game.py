"""
A world in lock-step: one step per accepted command of a person or a machine.

The values mirror the messages of humanopts_interfaces: the enums have the numbers of
``ActionCommand``, ``ActionRefusal``, ``ControlState``, ``GameState``, ``ResetGame`` and
``SetControl``; the dataclasses have the fields of the messages.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, fields
from enum import IntEnum
import math
from operator import attrgetter
from typing import Any

from humanopts_env.domains.base import ActableDomain, action_index, Domain, DomainError, StateError
from humanopts_env.domains.capabilities import step_effect, StepEffect
from humanopts_env.domains.described import published_state
from humanopts_env.seeding import generator
from humanopts_ros.limits import MAX_STATE


class Source(IntEnum):
    """The source of an action."""

    NONE = 0
    PERSON = 1
    MACHINE = 2


class Reason(IntEnum):
    """The reason for a refusal."""

    STALE = 1
    HELD_BY_PERSON = 2
    NO_SUCH_ACTION = 3
    EPISODE_OVER = 4
    NO_SUCH_SOURCE = 5
    PAUSED = 6
    FAILED = 7
    LOCKED = 8


class Holder(IntEnum):
    """The holder of control."""

    NOBODY = 0
    PERSON = 1
    LOCKED = 2  # a robot that no person has enabled


class ResetStatus(IntEnum):
    """The result of a reset."""

    OK = 1
    BAD_STATE = 2
    HELD_BY_PERSON = 3
    BAD_SOURCE = 4


class ControlStatus(IntEnum):
    """The result of a request for control."""

    OK = 1
    NOT_HOLDER = 2


@dataclass(frozen=True, slots=True)
class Command:
    """One ``ActionCommand``."""

    publisher_id: str
    sequence: int
    source: int  # a Source; other numbers are refused
    episode: int
    step: int
    action: str


@dataclass(frozen=True, slots=True)
class Transition:
    """One ``GameState``: the state of the game and the transition to it."""

    episode: int = 0
    step: int = 0
    state: str = ''
    features: tuple[float, ...] = ()
    previous_action: str = ''
    action_source: Source = Source.NONE
    action_publisher_id: str = ''
    action_sequence: int = 0
    reward: float = 0.0
    terminated: bool = False
    truncated: bool = False
    cut_short: bool = False  # the action was stopped before its end
    refreshed: bool = False  # the world changed while no action was under way

    @property
    def open(self) -> bool:
        """Whether a step can be taken."""
        return self.episode > 0 and not self.terminated and not self.truncated

    def follows(self, other: 'Transition') -> bool:
        """Return whether this transition is the step after another."""
        return (self.episode, self.step) == (other.episode, other.step + 1)

    def replaces(self, other: 'Transition') -> bool:
        """Return whether this transition replaces another of the same step in a changed world."""
        return self.refreshed and (self.episode, self.step) == (other.episode, other.step)


_PARTS = attrgetter(*(field.name for field in fields(Transition)))


def effect_between(domain: ActableDomain, before: Transition, after: Transition) -> StepEffect:
    """Return the effect of the step between two successive transitions of an episode."""
    action = action_index(domain, after.previous_action)
    states = (published_state(domain, each.state, each.features) for each in (before, after))
    return step_effect(domain, next(states), action, next(states))


def transition_from_message(message: Any) -> Transition:
    """
    Decode a ``GameState``, from rclpy or a bag reader.

    :raises ValueError: its source is unknown, or its reward is not finite.
    """
    if not math.isfinite(message.reward):
        raise ValueError(f'its reward is {message.reward}')
    episode, step, state, features, action, source, *more = _PARTS(message)
    numbers = tuple(map(float, features))
    return Transition(episode, step, state, numbers, action, Source(source), *more)


def check_transition(transition: Transition, domain: ActableDomain) -> Any:
    """
    Check a transition against the rules of its game.

    :return: the decoded state; None if no episode was started.
    :raises ValueError: the state, a feature or the action does not belong to the domain.
    """
    if not transition.episode:
        return None
    if len(transition.state) > MAX_STATE:
        raise ValueError(f'its state has {len(transition.state):,} characters')
    over = transition.terminated
    state = published_state(domain, transition.state, transition.features, over=over)
    check_features(transition.features, domain)
    if transition.step:
        action_index(domain, transition.previous_action)
    return state


def check_features(values: Sequence[float], domain: ActableDomain) -> None:
    """
    Check the features of a state.

    :raises ValueError: their number differs from the domain's, or one is out of range.
    """
    if len(values) != len(domain.features):
        raise ValueError(f'its features are not those of {domain.name}')
    for feature, value in zip(domain.features, values):
        if not feature.has(value):
            raise ValueError(f'its feature {feature.name} of {domain.name} cannot be {value:g}')


@dataclass(frozen=True, slots=True)
class Control:
    """One ``ControlState``."""

    holder: Holder
    holder_id: str
    reason: str
    supervisor_id: str = ''  # terminal that enabled the machine of a robot; empty if none


@dataclass(frozen=True, slots=True)
class Accepted:
    """A command that was executed."""

    transition: Transition
    control: Control | None  # new, if the command took control; None: unchanged


@dataclass(frozen=True, slots=True)
class Begun:
    """A command with an action that takes time; its state follows when the action has ended."""

    command: Command
    control: Control | None  # new, if the command took control; None: unchanged


@dataclass(frozen=True, slots=True)
class Refused:
    """A refused command, which changed nothing: one ``ActionRefusal``."""

    reason: Reason
    detail: str
    command: Command
    episode: int  # the current episode
    step: int


@dataclass(frozen=True, slots=True)
class Reply:
    """The answer to ``reset_game`` or ``set_control``."""

    status: ResetStatus | ControlStatus
    detail: str = ''
    transition: Transition | None = None  # first of the new episode; None: no episode was started
    control: Control | None = None  # the new state of control; None: unchanged


class LockStep(ABC):
    """
    The rules of control and refusal, shared by games and robots.

    A command of a machine must refer to the newest step, otherwise it is refused as stale. A
    refused request changes nothing.

    :ivar transition: the newest transition; episode 0 before the first reset.
    :ivar control: current control of the game.
    :ivar paused: reason why commands are refused now; empty if they are executed.
    """

    def __init__(self, domain: ActableDomain) -> None:
        self.domain = domain
        self.transition = Transition()
        self.control = Control(Holder.NOBODY, '', 'the game started')
        self.paused = ''

    @abstractmethod
    def command(self, command: Command) -> 'Result':
        """Execute a command, or refuse it."""

    def reset(self, start_state: str, seed: int, source: int) -> Reply:
        """
        Start a new episode.

        :param start_state: state in the domain's notation; empty: drawn with the seed.
        :param seed: seed of the start state and of all random draws of the episode, 0 or greater.
        :param source: a ``Source``; NONE counts as a machine, which is refused while a person
            holds control.
        :raises ValueError: the seed is negative.
        """
        if source not in tuple(Source):
            return Reply(ResetStatus.BAD_SOURCE, _no_such_source(source))
        if source != Source.PERSON and self.control.holder is Holder.PERSON:
            return Reply(ResetStatus.HELD_BY_PERSON, self._held())
        try:
            state, features = self._begin(start_state, seed)
        except DomainError as error:
            return Reply(ResetStatus.BAD_STATE, str(error))
        self.transition = Transition(self.transition.episode + 1, 0, state, features)
        return Reply(ResetStatus.OK, '', self.transition)

    def refusal(self, command: Command) -> Refused | None:
        """Return the refusal of a command at this moment; None if it would be executed."""
        objection = self._objection(command)
        return None if objection is None else self.refuse(command, *objection)

    def refuse(self, command: Command, reason: Reason, detail: str) -> Refused:
        """Return the refusal of a command."""
        return Refused(reason, detail, command, self.transition.episode, self.transition.step)

    def set_control(self, hold: bool, holder_id: str) -> Reply:
        """
        Take or release control for a person.

        :param hold: True: take control; False: release it.
        :param holder_id: publisher id of the person's terminal.
        """
        if not holder_id:
            return Reply(ControlStatus.NOT_HOLDER, 'holder_id is empty: name the terminal')
        if self.held_by_another(holder_id):
            return Reply(ControlStatus.NOT_HOLDER, self._held())
        if hold == (self.control.holder is Holder.PERSON):
            return Reply(ControlStatus.OK, 'nothing changed')
        if hold:
            control = self._give(holder_id, 'a person took control')
        else:
            control = self._returned('the person gave control back')
        return Reply(ControlStatus.OK, control.reason, control=control)

    def release(self, reason: str) -> Control:
        """Release control on behalf of its holder, such as a terminal that has left the graph."""
        self.control = Control(Holder.NOBODY, '', reason)
        return self.control

    def held_by_another(self, publisher_id: str) -> bool:
        """Return whether a person at another terminal holds control."""
        return self.control.holder is Holder.PERSON and self.control.holder_id != publisher_id

    @abstractmethod
    def _begin(self, start_state: str, seed: int) -> tuple[str, tuple[float, ...]]:
        """
        Begin an episode; return the text and the features of its first state.

        :raises DomainError: the state cannot be used.
        """

    def _objection(self, command: Command) -> tuple[Reason, str] | None:
        """Return the reason to refuse a command; None if it can be executed."""
        transition, machine = self.transition, command.source == Source.MACHINE
        if self.paused:
            return Reason.PAUSED, self.paused
        if command.source not in (Source.PERSON, Source.MACHINE):
            return Reason.NO_SUCH_SOURCE, _no_such_source(command.source)
        if not machine and not command.publisher_id:
            return Reason.NO_SUCH_SOURCE, 'a command of a person must carry its publisher_id'
        if self.held_by_another('' if machine else command.publisher_id):
            return Reason.HELD_BY_PERSON, self._held()
        if machine and self.control.holder is Holder.LOCKED:
            return Reason.LOCKED, (
                'no person has enabled the robot: take control and give it back '
                f'({self.control.reason})'
            )
        if not transition.open:
            return Reason.EPISODE_OVER, self._ending()
        if machine and (command.episode, command.step) != (transition.episode, transition.step):
            return Reason.STALE, (
                f'command for episode {command.episode} step {command.step}, but the game is at '
                f'episode {transition.episode} step {transition.step}'
            )
        try:
            action_index(self.domain, command.action)
        except DomainError as error:
            return Reason.NO_SUCH_ACTION, str(error)
        return None

    def _claim(self, command: Command) -> Control | None:
        """Give control to the person who sent a command; return it, or None if unchanged."""
        if command.source != Source.PERSON or self.control.holder is Holder.PERSON:
            return None
        return self._give(command.publisher_id, 'a person pressed a key')

    def _give(self, holder_id: str, reason: str) -> Control:
        self.control = Control(Holder.PERSON, holder_id, reason)
        return self.control

    def _returned(self, reason: str) -> Control:
        """End the control of a holder who is still present."""
        return self.release(reason)

    def _held(self) -> str:
        return f'control is held by the person at {self.control.holder_id}'

    def _ending(self) -> str:
        if self.transition.episode == 0:
            return 'no episode has begun; call reset_game'
        why = 'the task is over' if self.transition.terminated else 'it was cut off'
        return f'episode {self.transition.episode} has ended: {why}; call reset_game'


def step_transition(
    before: Transition,
    command: Command,
    state: str,
    features: tuple[float, ...],
    *,
    reward: float,
    terminated: bool,
    truncated: bool,
    cut_short: bool = False,
) -> Transition:
    """Return the transition of a step that a command has caused."""
    return Transition(
        before.episode,
        before.step + 1,
        state,
        features,
        previous_action=command.action,
        action_source=Source(command.source),
        action_publisher_id=command.publisher_id,
        action_sequence=command.sequence,
        reward=reward,
        terminated=terminated,
        truncated=truncated and not terminated,
        cut_short=cut_short,
    )


class Game(LockStep):
    """One game of a domain, in lock-step: one step per accepted command."""

    domain: Domain

    def __init__(self, domain: Domain) -> None:
        super().__init__(domain)
        self._state: Any = None
        self._rng = generator(0, 'episode', domain.name)

    def command(self, command: Command) -> 'Accepted | Refused':
        """Take one step, or refuse it."""
        refused = self.refusal(command)
        if refused is not None:
            return refused
        action = action_index(self.domain, command.action)
        try:
            outcome = self.domain.step(self._state, action, self._rng)
        except DomainError as error:
            return self.refuse(command, Reason.FAILED, str(error))
        self._state = outcome.state
        self.transition = step_transition(
            self.transition,
            command,
            *self._observed(),
            reward=outcome.reward,
            terminated=outcome.terminated,
            truncated=0 < self.domain.max_steps <= self.transition.step + 1,
        )
        return Accepted(self.transition, self._claim(command))

    def _begin(self, start_state: str, seed: int) -> tuple[str, tuple[float, ...]]:
        rng = generator(seed, 'episode', self.domain.name)
        state = self.domain.decode(start_state) if start_state else self.domain.reset(rng)
        if start_state and self.domain.is_over(state):
            raise StateError(f'the task is already over in {start_state!r}')
        self._rng, self._state = rng, state
        return self._observed()

    def _observed(self) -> tuple[str, tuple[float, ...]]:
        values = self.domain.feature_values(self._state)
        return self.domain.encode(self._state), tuple(values.tolist())


def _no_such_source(source: int) -> str:
    return f'source {source} is neither person (1) nor machine (2)'


Result = Accepted | Begun | Refused


MAX_PERIOD = 60.0  # s between steps of the machine


class Pacing:
    """
    Delays commands of a machine, one at a time; commands of a person are never delayed.

    A spectator can change the pace, pause the machine and single-step it.

    As without pacing, the first command for a step wins: while it waits, others for the same step
    are refused as stale. A command that would be refused anyway is not delayed.

    :ivar waiting: the delayed command; None if none.
    :ivar period: minimum time between steps of the machine, s.
    :ivar paused_by: publisher id of the terminal that paused the machine; empty if none.
    """

    def __init__(self, game: LockStep, period: float = 0.0) -> None:
        self._game = game
        self.waiting: Command | None = None
        self.period = period
        self.paused_by = ''
        self._steps = 0  # steps allowed while paused

    def set_pace(self, period: float, paused_by: str, steps: int = 0) -> list[Result]:
        """
        Change the pace.

        :param period: 0 to MAX_PERIOD, s.
        :param paused_by: publisher id of the terminal that pauses the machine; empty if none.
        :param steps: number of single steps allowed while paused.
        :return: the result of a delayed command that is executed now.
        """
        self.period, self.paused_by = period, paused_by
        self._steps = steps if paused_by else 0
        return self.due()

    def offer(self, command: Command) -> list[Result]:
        """
        Execute, refuse or delay a command.

        :return: the result of the command, unless it is delayed, and the refusal of a stale
            delayed command that it replaces.
        """
        game, before = self._game, self.waiting
        paced = self.period or self.paused_by or before is not None
        if command.source == Source.PERSON or not paced:
            return [game.command(command)]
        refused = game.refusal(command)
        if refused is not None:
            return [refused]
        overtaken = None if before is None else game.refusal(before)
        if before is not None and overtaken is None:
            detail = f'step {command.step} is answered: {before.action!r} waits for step_period'
            return [game.refuse(command, Reason.STALE, detail)]
        self.waiting = command
        results: list[Result] = [] if overtaken is None else [overtaken]
        return results if self.period and not self._steps else results + self.due()

    def due(self) -> list[Result]:
        """Execute the delayed command, if any, unless the machine is paused."""
        command = self.waiting
        if command is None:
            return []
        if self.paused_by and self._game.refusal(command) is None:
            if not self._steps:
                return []
            self._steps -= 1
        self.waiting = None
        return [self._game.command(command)]
