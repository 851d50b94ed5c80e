"""A robot in lock-step: a step is an action that takes time and can be stopped."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Protocol

from humanopts_env.domains.base import (
    ActableDomain,
    DomainError,
    FeatureKind,
    StateError,
)
from humanopts_env.game import (
    Begun,
    Command,
    Control,
    ControlStatus,
    Holder,
    LockStep,
    Reason,
    Refused,
    Reply,
    Result,
    Source,
    step_transition,
    Transition,
)
from humanopts_env.worlds.sensors import Sensed
from humanopts_env.worlds.world import Ending, Timing

CHANGE = 0.01  # share of the range that counts as a change of a continuous feature
_SLACK = 0.002  # s by which a timer may be early


class Robot(Protocol):
    """The robot of an ``ActedGame``, which acts and senses."""

    def start(self, action: str) -> None:
        """
        Begin an action.

        :raises DomainError: the action cannot begin.
        """

    def halt(self) -> None:
        """Stop, and cancel the action, if any; may be called at any time."""

    def sense(self) -> Sensed:
        """
        Return the features that are sensed now.

        :raises DomainError: the features cannot be sensed.
        """

    def text(self, features: tuple[float, ...]) -> str:
        """Return the text of the state."""

    def ending(self, before: tuple[float, ...], action: str, after: tuple[float, ...]) -> Ending:
        """
        Return the reward of a step and whether it ends the episode.

        :raises DomainError: the reward is unknown.
        """

    def show(self, transition: Transition) -> None:
        """Publish a state."""


@dataclass(frozen=True, slots=True)
class UnderWay:
    """The action that is being carried out."""

    command: Command
    since: float  # start time, s
    cut_short: bool = False
    done: float | None = None  # time at which it ended and settling began, s; None: not ended


class ActedGame(LockStep):
    """
    A robot in lock-step.

    An accepted command begins an action. ``tick`` ends it at its deadline, and ``finish`` when the
    robot reports its end; a stop, a person's key, a fault or a missed deadline cuts it short. Then
    the state of the next step is published. If it cannot be sensed after a fault, the last sensed
    state is used.

    :ivar under_way: the action that is carried out; None if none.
    :ivar supervised: whether machines may act only after a person has enabled them.
    :ivar outside: description of a feature out of its range; only a person may then act. Empty if
        all are in range.
    """

    def __init__(
        self,
        domain: ActableDomain,
        robot: Robot,
        clock: Callable[[], float],
        timings: Mapping[str, Timing],
        *,
        step: float,
        supervised: bool,
    ) -> None:
        """
        Start without an episode.

        :param clock: function that returns the time, s.
        :param timings: timing of each action by name.
        :param step: minimum time between states published because the world changed, s.
        """
        super().__init__(domain)
        self._robot, self._clock, self._timings, self._step = robot, clock, timings, step
        self.supervised = supervised
        self.outside = ''
        self.under_way: UnderWay | None = None
        self._shown_at = 0.0
        if supervised:
            self.control = Control(Holder.LOCKED, '', 'the world started')

    def command(self, command: Command) -> Result:
        """Begin an action, or refuse it; a person's command ends the action under way."""
        refused = self.refusal(command)
        if refused is None and self.under_way is not None:
            self.cut_short()
            refused = self.refusal(command)  # the episode may be over
        if refused is not None:
            return refused
        try:
            self._robot.start(command.action)
        except DomainError as error:
            self._robot.halt()
            return self.refuse(command, Reason.FAILED, str(error))
        self.under_way = UnderWay(command, self._clock())
        return Begun(command, self._claim(command))

    def stop(self, command: Command) -> Control | Refused | None:
        """
        Execute a stop, a command without an action.

        A person's stop always ends the action under way; a machine's stop ends only its own.

        :return: the new control if the person took it, or the refusal; None if neither.
        """
        machine, under_way = command.source == Source.MACHINE, self.under_way
        if command.source not in (Source.PERSON, Source.MACHINE) or not command.publisher_id:
            detail = 'a stop must carry its source and publisher_id'
            return self.refuse(command, Reason.NO_SUCH_SOURCE, detail)
        if machine and under_way is not None:
            by = under_way.command.publisher_id
            if by != command.publisher_id:
                return self.refuse(command, Reason.STALE, f'the action under way is that of {by}')
        self.cut_short()
        another = self.held_by_another(command.publisher_id)
        return None if machine or another else self._claim(command)

    def tick(self) -> None:
        """End an action that has reached its deadline, and publish the state if it has changed."""
        now, under_way = self._clock(), self.under_way
        if under_way is None:
            if now - self._shown_at >= self._step - _SLACK:
                self._refresh()
            return
        timing = self._timings[under_way.command.action]
        if under_way.done is not None:
            if now - under_way.done >= timing.settle - _SLACK:
                self._end(under_way)
        elif now - under_way.since >= timing.seconds - _SLACK:
            self.finish(cut_short=not timing.timed)

    def finish(self, *, cut_short: bool = False) -> None:
        """
        Record the end of the action under way.

        :param cut_short: whether the action was not completed.
        """
        under_way = self.under_way
        if under_way is None or under_way.done is not None:
            return
        timing = self._timings[under_way.command.action]
        if timing.timed or cut_short:
            self._robot.halt()
        self.under_way = replace(under_way, done=self._clock(), cut_short=cut_short)
        if not timing.settle:
            self._end(self.under_way)

    def cut_short(self) -> None:
        """Stop the robot at once; the action under way, if any, is cut short."""
        self._robot.halt()
        if (under_way := self.under_way) is not None:
            lasted = under_way.done is None
            self._end(replace(under_way, cut_short=lasted or under_way.cut_short))

    def pause(self, reason: str) -> None:
        """Stop the robot and refuse commands, or accept them again if the reason is empty."""
        if reason and not self.paused:
            self.cut_short()
        self.paused = reason

    def restrict(self, outside: str) -> None:
        """Let only a person act while a feature is out of its range; empty: none is."""
        under_way, self.outside = self.under_way, outside
        if outside and under_way is not None and under_way.command.source == Source.MACHINE:
            self.cut_short()

    def lock(self, reason: str) -> Control:
        """Stop the robot until a person takes control."""
        self.cut_short()
        self.control = Control(Holder.LOCKED, '', reason)
        return self.control

    def release(self, reason: str) -> Control:
        """Stop the robot because the holder or the supervisor has left."""
        if self.supervised:
            return self.lock(reason)
        self.cut_short()
        return super().release(reason)

    def set_control(self, hold: bool, holder_id: str) -> Reply:
        """Take or release control for a person; taking it stops a machine."""
        reply = super().set_control(hold, holder_id)
        if hold and reply.status is ControlStatus.OK and reply.control is not None:
            self.cut_short()
        return reply

    def _returned(self, reason: str) -> Control:
        supervisor = self.control.holder_id if self.supervised else ''
        self.control = Control(Holder.NOBODY, '', reason, supervisor)
        return self.control

    def _objection(self, command: Command) -> tuple[Reason, str] | None:
        objection, under_way = super()._objection(command), self.under_way
        if objection is not None or command.source != Source.MACHINE:
            return objection
        if self.outside:
            return Reason.PAUSED, self.outside
        if under_way is not None:
            name = under_way.command.action
            return Reason.STALE, f'step {command.step} is answered: {name!r} is under way'
        return None

    def _begin(self, start_state: str, seed: int) -> tuple[str, tuple[float, ...]]:
        if start_state:
            raise StateError(
                f'{self.domain.name} can only begin where the robot is: drive it to another start'
            )
        self.cut_short()
        sensed = self._robot.sense()
        self._shown_at = self._clock()
        return self._text(sensed), sensed.features

    def _end(self, under_way: UnderWay) -> None:
        """Publish the state after an action."""
        before, cut_short = self.transition, under_way.cut_short
        self.under_way = None
        try:
            sensed = self._robot.sense()
            features, state = sensed.features, self._text(sensed)
            ending = self._robot.ending(before.features, under_way.command.action, features)
        except DomainError:
            features, state = before.features, before.state
            ending, cut_short = Ending(0.0), True
        self.transition = step_transition(
            before,
            under_way.command,
            state,
            features,
            reward=ending.reward,
            terminated=ending.terminated,
            truncated=ending.truncated or 0 < self.domain.max_steps <= before.step + 1,
            cut_short=cut_short,
        )
        self._show()

    def _refresh(self) -> None:
        """Publish the state again if a feature has changed."""
        if not self.transition.open:
            return
        try:
            sensed = self._robot.sense()
        except DomainError:
            return
        if self._differs(sensed.features):
            self.transition = replace(
                self.transition,
                state=self._text(sensed),
                features=sensed.features,
                refreshed=True,
            )
            self._show()

    def _text(self, sensed: Sensed) -> str:
        text = self._robot.text(sensed.features)
        return f'{text}; {sensed.outside}' if sensed.outside else text

    def _differs(self, features: tuple[float, ...]) -> bool:
        rows = zip(self.domain.features, self.transition.features, features)
        return any(
            abs(new - old) >= CHANGE * feature.span
            if feature.kind is FeatureKind.CONTINUOUS
            else new != old
            for feature, old, new in rows
        )

    def _show(self) -> None:
        self._shown_at = self._clock()
        self._robot.show(self.transition)
