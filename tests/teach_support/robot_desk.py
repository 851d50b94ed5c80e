"""A person at the dialogue with a robot, which moves while time passes; nothing needs ROS."""

from pathlib import Path

from humanopts_env.domains.base import Action, Feature
from humanopts_env.domains.described import DescribedDomain
from humanopts_env.game import Begun, Command, Holder, Source, Transition
from humanopts_env.worlds.acted_game import ActedGame
from humanopts_env.worlds.sensors import Sensed
from humanopts_env.worlds.world import Ending, Timing
from humanopts_teach.lesson.requests import (
    Answer,
    Drive,
    Progress,
    Request,
    RequestStatus,
)

from teach_support.desk import Desk, ME

SPEED = {'forward': 1.0, 'back': -1.0, 'wait': 0.0, 'home': -1.0}  # m/s
TIMINGS = {
    'forward': Timing(0.5),
    'back': Timing(0.5),
    'wait': Timing(0.5),
    'home': Timing(20.0, timed=False),
}
KEYS = {'forward': 'right', 'back': 'left', 'wait': '.', 'home': 'h'}
DOMAIN = DescribedDomain(
    'corridor',
    {},
    [
        Feature.continuous('x', 'how far east it is', 0, 10, 'm'),
        Feature.nominal('door', 'whether the door is open', ['open', 'closed']),
    ],
    [Action(n, KEYS[n], n, t.seconds, idle=n == 'wait') for n, t in TIMINGS.items()],
    0.99,
    0,
)
TICK = 0.1  # s


class Rover:
    """A rover in a corridor of 10 m, with its home at the west end."""

    def __init__(self, desk: 'RobotDesk') -> None:
        self.x, self.door, self.speed = 5.0, 0.0, 0.0
        self._desk = desk

    def start(self, action: str) -> None:
        self.speed = SPEED[action]

    def halt(self) -> None:
        self.speed = 0.0

    def sense(self) -> Sensed:
        return Sensed((self.x, self.door))

    def text(self, features: tuple[float, ...]) -> str:
        return f'x {features[0]:.2f}, door {features[1]:g}'

    def ending(self, before: tuple[float, ...], action: str, after: tuple[float, ...]) -> Ending:
        return Ending(-1.0)

    def show(self, transition: Transition) -> None:
        self._desk.see_state(transition)


class RobotDesk(Desk):
    """
    Presses keys while a robot moves.

    :ivar rover: what the robot really does.
    """

    def __init__(self, folder: Path) -> None:
        self.time = 0.0
        self.rover = Rover(self)
        self._driving: Drive | None = None  # not answered yet
        self._number = 0  # of commands of the person
        super().__init__(DOMAIN, folder)

    def make_game(self) -> ActedGame:
        return ActedGame(DOMAIN, self.rover, lambda: self.time, TIMINGS, step=0.2, supervised=True)

    def see_state(self, transition: Transition) -> None:
        """Let lesson and terminal see a state, which answers the action that led to it."""
        self.world.update_game(transition)
        self.lesson.add_transition(transition)
        mine = transition.action_publisher_id == ME and not transition.refreshed
        if self._driving is not None and mine and transition.action_sequence == self._number:
            driven, self._driving = self._driving, None
            self.publish()
            self.app.replied(driven, Answer(RequestStatus.OK, ''), self.now)

    def after(self, seconds: float) -> 'RobotDesk':
        """Let time pass."""
        for _ in range(round(seconds / TICK)):
            self.time += TICK
            moved = round(self.rover.x + self.rover.speed * TICK, 6)
            self.rover.x = min(max(moved, 0.0), 10.0)
            if self.rover.x == 0.0:
                self.game.finish()
            self.game.tick()
            self.publish()
            self.advance(TICK)
        return self

    def moves(self, action: str) -> None:
        """Let the machine begin an action."""
        here = self.game.transition
        self.game.command(Command('machine', 0, Source.MACHINE, here.episode, here.step, action))
        self.publish()
        self.advance()

    def publish(self) -> None:
        super().publish()
        control, under_way = self.game.control, self.game.under_way
        self.world.locked = control.reason if control.holder is Holder.LOCKED else ''
        self.world.supervisor = control.supervisor_id
        self.world.progress = Progress(stopped=self.game.paused)
        if under_way is not None:
            self.world.progress = Progress(
                action=under_way.command.action, seconds=self.time - under_way.since
            )

    def advance(self, seconds: float = 0.0) -> 'RobotDesk':
        """Let time pass for the terminal; an action is answered when it has ended."""
        self.now += seconds
        while (request := self.app.advance(self.now)) is not None:
            self.asked.append(request)
            answer = self.carry_out(request)
            self.publish()
            if answer is not None:
                self.app.replied(request, answer, self.now)
        return self

    def carry_out(self, request: Request) -> Answer | None:
        """Answer as the graph would; None: later, or never."""
        here, answer = self.game.transition, None
        if isinstance(request, Drive):
            number = self._number + bool(request.action)
            command = Command(ME, number, Source.PERSON, here.episode, here.step, request.action)
            if not request.action:
                self.game.stop(command)
            elif not isinstance(taken := self.game.command(command), Begun):
                return Answer(RequestStatus.REFUSED, taken.detail)
            else:
                self._number, self._driving = number, request
        else:
            answer = super().carry_out(request)
        self.publish()
        if self.app.run is not None and self.world.in_control:
            self.app.run_ended(self.app.run, True, 'You took over.')
        return answer
