"""The node ``joy_teleop``: a person drives with a gamepad, next to the terminal."""

from functools import partial
import sys
from typing import Any, ClassVar

from humanopts_env.domains.base import ActableDomain
from humanopts_interfaces.msg import NodeStatus
from humanopts_ros.guarded_node import StartError
from humanopts_ros.node_base import NodeBase
from humanopts_ros.process import run_node
from humanopts_ros.qos import SENSOR
from humanopts_teach.gamepad import Deed, DEFAULT, Gamepad, GamepadError, read_mapping, Reading
from humanopts_teach.lesson.requests import (
    AnswerQuestion,
    BeginDemonstration,
    Drive,
    EndDemonstration,
    Phase,
    RunOption,
    ServiceRequest,
    SetControl,
    Verdict,
)
from humanopts_teach.ros.convert import ACTIONS, TEACHING
from humanopts_teach.ros.graph_client import ClientError, Goal, GraphClient
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.task import Future
from sensor_msgs.msg import Joy

_PATIENCE = 5.0  # s, timeout for an answer to a command, in addition to the duration of its action
_LONG = 1.0  # s; a new control interrupts an action that has more time left
_BEGINS = Phase.READY, Phase.CHECKING, Phase.EXAM, Phase.FINISHED
_VERDICTS = {
    Deed.DONE: Verdict.DONE,
    Deed.NOT_HERE: Verdict.NOT_HERE,
    Deed.DISCARD: Verdict.DISCARD,
}


class JoyTeleopNode(NodeBase):
    """Turns messages of one gamepad into commands of a person, and into answers to the lesson."""

    drives: ClassVar[bool] = True

    def __init__(self, **options: Any) -> None:
        super().__init__('joy_teleop', **options)
        what = 'file that maps the buttons and axes, or the word default, for an Xbox pad'
        mapping = self.setting('mapping', DEFAULT, what)
        self._timeout = self.setting(
            'timeout', 0.3, 's without a message of the gamepad until a robot stops', (0.05, 10.0)
        )
        try:
            self._mapping = read_mapping(mapping)
        except GamepadError as error:
            raise StartError(f'parameter mapping: {error}') from error
        self._pad: Gamepad | None = None  # None until the world is known
        self._reading = Reading()
        self._client = GraphClient(
            self, {**TEACHING, RunOption: ACTIONS[RunOption]}, on_change=self._on_world
        )
        self._seconds: dict[str, float] = {}  # duration of each action
        self._next = ''  # action of a newly pressed control, not sent yet
        self._sent: Future | None = None  # answer to the last command
        self._give_up_at = self._repeat_at = 0.0
        self._run: Goal | None = None  # run of the exam begun here
        self._busy = False  # a deed is being carried out
        self._deed = Deed.STOP  # deed in progress or carried out last
        self._pressed: tuple[Deed, ...] = ()  # deeds of a button pressed in the meantime
        group = ReentrantCallbackGroup()
        self._work = self.create_timer(0.0, self._carry_out, callback_group=group, autostart=False)
        self._fault = self._said = ''
        self._joy = self.create_subscription(Joy, 'joy', self._on_joy, SENSOR)
        self._silent = self.create_timer(self._timeout, self._on_silence, autostart=False)

    def waits_for(self) -> str | None:
        """Wait for the world."""
        if self._pad is None:
            self._find_actions(self._client.world.domain)
        return None if self._pad and self._client.is_ready(Drive) else 'domain_info'

    def on_ready(self) -> None:
        """Start the timer that reports a missing gamepad."""
        self._silent.reset()

    def close(self) -> None:
        """Stop the person's action in progress."""
        if self._sent is not None and not self._sent.done():
            self._stop()

    def _find_actions(self, domain: ActableDomain | None) -> None:
        if domain is None:
            return
        try:
            self._pad = Gamepad(self._mapping, domain.actions)
        except GamepadError as error:
            raise StartError(f'parameter mapping: {error}') from error
        self._seconds = {each.name: each.seconds for each in domain.actions}

    @property
    def _takes_time(self) -> bool:
        """Whether actions take time, so that one may be under way."""
        return any(self._seconds.values())

    def _on_joy(self, joy: Joy) -> None:
        if self._pad is None or not self.ready:
            return
        self._silent.reset()
        if (pads := self._joy.get_publisher_count()) > 1:
            self._on_fault(
                f'{pads} gamepads publish on {self._joy.topic_name}: give each a topic and a '
                'joy_teleop of its own (-r joy:=TOPIC -r __node:=NAME)'
            )
            return
        try:
            reading = self._pad.read(joy.axes, joy.buttons)
        except GamepadError as error:
            self._on_fault(str(error))
            return
        if self._fault:
            self._fault = ''
            self.set_status(NodeStatus.STATE_READY)
        self._reading = reading
        if reading.released:
            self._stop()
        elif reading.fresh:
            self._next = reading.action
        self._drive()
        if reading.deeds:
            self._press(reading.deeds)

    def _on_silence(self) -> None:
        self._silent.cancel()
        self._on_fault(
            f'no message on {self._joy.topic_name} for {self._timeout:g} s: check the gamepad, '
            'and that its driver repeats messages (autorepeat_rate 20)'
        )

    def _on_fault(self, text: str) -> None:
        """Stop, and do nothing until the gamepad works and its dead-man button is released."""
        assert self._pad is not None, 'called when the world is known'
        world = self._client.world
        in_charge = self.publisher_id in (world.holder, world.supervisor)
        if self._reading.held or (in_charge and text != self._fault):
            self._stop()
        self._pad.disarm()
        self._reading, self._next = Reading(), ''
        if text != self._fault:
            self._fault = text
            self.set_status(NodeStatus.STATE_PAUSED, text)
            self.get_logger().warning(text)

    def _on_world(self) -> None:
        """Send the next command as soon as the last one is answered."""
        if self.ready:
            self._drive()

    def _drive(self) -> None:
        """Send the next command, if there is one and the last one is answered."""
        reading, now, game = self._reading, self.monotonic(), self._client.world.game
        if not reading.held:
            self._next = ''
            return
        action = self._next
        if not action and reading.repeats and now >= self._repeat_at:
            action = reading.action
        if not action or not game.open:
            return
        if self._sent is not None and not self._sent.done() and now < self._give_up_at:
            left = self._give_up_at - _PATIENCE - now
            if not self._next or left < _LONG:
                return
        self._next, seconds = '', self._seconds[action]
        self._repeat_at = now + (0.0 if seconds else self._mapping.repeat)
        self._give_up_at = now + seconds + _PATIENCE
        self._sent = sent = self._client.send(Drive(action, game.episode, game.step))
        sent.add_done_callback(partial(self._on_answer, action))

    def _on_answer(self, action: str, done: Future) -> None:
        if not done.result().ok:
            self._repeat_at = self.monotonic() + self._mapping.repeat
            self._say(f'{action}: {done.result().detail}')

    def _stop(self) -> None:
        """End the action under way, the person's or the machine's."""
        self._next = ''
        if self._takes_time:
            game = self._client.world.game
            self._client.send(Drive('', game.episode, game.step))

    def _say(self, text: str) -> None:
        """Log a line for the person, unless it is the same as the last one."""
        if text != self._said:
            self._said = text
            self.get_logger().warning(text)

    def _applies(self, deed: Deed) -> bool:
        """Return whether the lesson and the world currently allow a deed."""
        world = self._client.world
        phase, shows = world.lesson.phase, world.lesson.phase is Phase.DEMONSTRATING
        match deed:
            case Deed.BEGIN:
                return phase in _BEGINS
            case Deed.DONE | Deed.NOT_HERE:
                return shows and not world.lesson.exam
            case Deed.DISCARD:
                return shows
            case Deed.YES | Deed.NO:
                return phase in (Phase.ASKING, Phase.CHECKING) or (shows and world.lesson.exam)
            case Deed.GIVE_CONTROL:
                return world.in_control
            case Deed.TAKE_CONTROL:
                return not world.in_control
            case Deed.STOP:
                return True

    def _press(self, deeds: tuple[Deed, ...]) -> None:
        """Start the first possible deed of a button; during another one, queue the button."""
        if Deed.STOP in deeds:
            self._stop()
        if self._busy:
            self._pressed = deeds
        elif deed := next(filter(self._applies, deeds), None):
            self._busy, self._deed = True, deed
            self._work.reset()
        else:
            phase = self._client.world.lesson.phase.value
            self._say(f'{deeds[0]}: not now (the lesson: {phase})')

    async def _carry_out(self) -> None:
        """Carry out the current deed; log a refusal."""
        self._work.cancel()
        deed = self._deed
        try:
            if self._takes_time and deed in _VERDICTS:
                await self._stand_still()
            for request in self._requests(deed):
                await self._client.ask(request)
            if deed is Deed.BEGIN and self._client.world.lesson.exam:
                lesson = self._client.world.lesson
                goal = RunOption(lesson.option_name, lesson.participant)
                self._run = self._client.start(goal, lambda feedback: None)
                self._run.accepted.add_done_callback(self._on_accepted)
        except ClientError as error:
            self._say(str(error))
        finally:
            self._busy = False
            if pressed := self._pressed:
                self._pressed = ()
                self._press(pressed)

    def _on_accepted(self, done: Future) -> None:
        if not done.result().ok:
            self._run = None
            self._say(done.result().detail)

    async def _stand_still(self) -> None:
        """End the person's action under way, so that the last state is known."""
        if (sent := self._sent) is not None and not sent.done():
            self._stop()
            await self.waiting.until(sent.done, _PATIENCE)

    def _requests(self, deed: Deed) -> list[ServiceRequest]:
        """Return the requests that carry out a deed."""
        world = self._client.world
        lesson, game = world.lesson, world.game
        runs = self._run is not None and not self._run.result.done()
        match deed:
            case Deed.BEGIN if lesson.phase is Phase.EXAM:
                takes = world.robot and (world.locked or world.supervisor != world.me)
                take = [SetControl(hold=True)] if takes else []  # required before release
                return [BeginDemonstration(exam=True), *take, SetControl(hold=False)]
            case Deed.BEGIN:
                return [BeginDemonstration()]
            case Deed.YES | Deed.NO if lesson.exam:
                verdict = Verdict.RIGHT if deed is Deed.YES else Verdict.WRONG
                take = [SetControl(hold=True)] if runs else []  # ends the run
                return [*take, EndDemonstration(verdict, game.episode, game.step, stopped=runs)]
            case Deed.YES | Deed.NO:
                return [AnswerQuestion(lesson.question_id, deed is Deed.YES)]
            case Deed.TAKE_CONTROL | Deed.GIVE_CONTROL:
                return [SetControl(hold=deed is Deed.TAKE_CONTROL)]
            case Deed.STOP:  # in a game, the machine waits while a person has control
                return [] if self._takes_time else [SetControl(hold=True)]
            case _:
                return [EndDemonstration(_VERDICTS[deed], game.episode, game.step)]


main = partial(run_node, JoyTeleopNode)

if __name__ == '__main__':
    sys.exit(main())
