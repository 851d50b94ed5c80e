"""The node ``world``, which turns a robot or simulator on the graph into a world."""

from functools import partial
import sys
from typing import Any, ClassVar

from humanopts_env.domains.names import ROBOT, robot_file
from humanopts_env.game import Begun, Command, Control, Refused, Transition
from humanopts_env.ros.actuators import Actuator, make_actuators, Report, Velocities
from humanopts_env.ros.interfaces import interface
from humanopts_env.ros.lock_step_node import LockStepNode
from humanopts_env.worlds.acted_game import ActedGame
from humanopts_env.worlds.sensors import Sensed, SensorError, Sensors
from humanopts_env.worlds.world import Ending, load_world, World
from humanopts_env.worlds.world_file import Topic, WorldFileError
from humanopts_interfaces.msg import ActionProgress
from humanopts_ros.guarded_node import StartError
from humanopts_ros.liveliness import Liveliness
from humanopts_ros.peers import announced_ids, publishers_of
from humanopts_ros.process import run_node
from humanopts_ros.qos import CURRENT, LATCHED, LEASE, SENSOR, STREAM
from humanopts_ros.senders import signer
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

_DRIVE_PERIOD = 0.05  # s between velocities, and between checks while an action lasts
_WATCH_PERIOD = 0.1  # s between checks while no action lasts
_GRAPH_PERIOD = 1.0  # s between searches for other worlds
_CLOCK_SILENCE = 0.4  # s without /clock after which it counts as missing
_PROGRESS_PERIOD = 0.1  # s between reports of progress


class RosRobot:
    """The robot of a world: its topics, and the actuators of its actions."""

    def __init__(self, node: 'WorldNode', world: World) -> None:
        """
        Subscribe to the world's topics.

        :raises WorldFileError: a type is not installed, or lacks a field.
        """
        file = world.file
        kinds = {name: interface(topic.type) for name, topic in file.topics.items()}
        world.check_types({name: kind() for name, kind in kinds.items()})
        self._node, self._world = node, world
        velocity = file.velocity_topic
        self._velocities = Velocities(node, velocity) if velocity is not None else None
        self._actuators = make_actuators(node, file, self._velocities)
        self._actuator = Actuator()
        self._repeated = 0.0
        self.report = Report(node.on_ended)  # on the newest action
        self.sensors = Sensors(file.topics)
        for name, topic in file.topics.items():
            qos = CURRENT if topic.latched else SENSOR
            node.create_subscription(kinds[name], topic.topic, partial(self._note, name), qos)

    def _note(self, name: str, message: Any) -> None:
        self.sensors.note(name, message, self._node.now())

    def start(self, action: str) -> None:
        self._actuator, self.report = self._actuators[action], Report(self._node.on_ended)
        self._repeated = self._node.now()
        self._actuator.start(self.report)

    @property
    def clearing(self) -> str:
        """The event that is awaited before an action can begin; empty if none."""
        return next(filter(None, (each.clearing for each in self._actuators.values())), '')

    def repeat(self) -> None:
        """Send the velocity again if it is due."""
        now = self._node.now()
        if now - self._repeated > 0.9 * _DRIVE_PERIOD:
            self._repeated = now
            self._actuator.repeat()

    def halt(self) -> None:
        self._actuator.stop()
        self._actuator = Actuator()
        if self._velocities is not None:
            self._velocities.send()

    def sense(self) -> Sensed:
        self.sensors.check(self._node.now())
        return self._world.sense(self.sensors)

    def text(self, features: tuple[float, ...]) -> str:
        return self._world.text(features)

    def ending(self, before: tuple[float, ...], action: str, after: tuple[float, ...]) -> Ending:
        return self._world.ending(before, action, after, self.sensors)

    def show(self, transition: Transition) -> None:
        self._node.send_transition(transition)
        if not transition.refreshed:
            self._node.report_progress()


class WorldNode(LockStepNode):
    """
    The world of a robot.

    The node moves nothing on its own. It ends the action and stops the robot on any fault: a stale
    or invalid sensor, the emergency stop, another world in the namespace, or the end of the
    process that acts or supervises.
    """

    drives: ClassVar[bool] = True
    _game: ActedGame

    def __init__(self, **options: Any) -> None:
        super().__init__('world', **options)
        self._progress = self.stamped_publisher(ActionProgress, 'action_progress', LATCHED)
        self._progress_at = 0.0
        self._lively = Liveliness(self, 'node', self._on_lost)
        self._twins = Liveliness(self, 'game')  # worlds with the same node name
        self._others: list[str] = []  # publisher ids of other worlds
        self._rivals: list[str] = []  # other world nodes that drive the same robot
        self._emergency = False
        safety = self._world.file.safety
        if safety.emergency is not None:
            for qos in (CURRENT, STREAM, SENSOR):  # latched, reliable, or neither
                self.create_subscription(Bool, safety.emergency, self._on_emergency, qos)
        self.create_service(Trigger, 'stop', self._on_stop)
        self._drive = self.create_timer(_DRIVE_PERIOD, self._tick, autostart=False)
        self.create_timer(_WATCH_PERIOD, self._tick)
        self.create_timer(_GRAPH_PERIOD, self._look_around)

    def make_game(self) -> ActedGame:
        """Return the game of the world file in the parameters."""
        self._simulated = -1.0  # s, newest time on /clock; below 0: none has arrived
        self._clock_at = self.monotonic()  # time of its arrival, s
        path = self.setting('world', '', 'absolute path of a world file, or FILE.py:CLASS')
        try:
            self._world = load_world(f'{ROBOT}{path}')
        except WorldFileError as error:
            raise StartError(str(error)) from error
        try:
            self._robot = RosRobot(self, self._world)
        except WorldFileError as error:
            raise StartError(f'{robot_file(path)[0].name}: {error}') from error
        file = self._world.file
        if file.use_sim_time:
            self.set_parameters([Parameter('use_sim_time', value=True)])
        self._by_clock = bool(self.get_parameter('use_sim_time').value)
        if self._by_clock:
            self.create_subscription(Clock, '/clock', self._on_clock, SENSOR)
        return ActedGame(
            self._world.domain,
            self._robot,
            self.now,
            self._world.timings,
            step=file.step,
            supervised=file.safety.supervised,
        )

    def now(self) -> float:
        """Return the time for sensors and actions, s; from /clock with use_sim_time."""
        return self._simulated if self._by_clock else self.monotonic()

    def waits_for(self) -> str | None:
        """Describe what the world is waiting for; None if nothing."""
        if self._by_clock and self._simulated < 0:
            return '/clock, because use_sim_time is set'
        for name, topic in self._world.file.topics.items():
            if not self._robot.sensors.has(name):
                return self._missing(topic)
        if self._robot.clearing:
            return self._robot.clearing
        self._look_around()
        if self._others:
            return f'the end of {self._others[0]}, another world in this namespace'
        fault, _ = self._faults()
        return f'this to end: {fault}' if fault else None

    def on_ready(self) -> None:
        """Publish the domain, the first state, and that no action is under way."""
        self._robot.halt()
        super().on_ready()
        self.report_progress()

    def close(self) -> None:
        """Stop the robot."""
        if self.ready:
            self._game.cut_short()
        super().close()

    def offer(self, command: Command) -> None:
        """Execute a command or a stop, unless there is a fault."""
        self._check()
        if command.action:
            super().offer(command)
            return
        result = self._game.stop(command)
        if isinstance(result, Refused):
            self.send_refusal(result)
        elif result is not None:
            self.send_control(result)

    def on_begun(self, begun: Begun) -> None:
        """Watch the process that acts, and start the timer of the action."""
        self._watch(begun.command.publisher_id)
        self.report_progress()
        self._drive.reset()
        if not self._world.timings[begun.command.action].seconds:
            self._game.tick()

    def on_ended(self, report: Report, well: bool) -> None:
        """Handle the end of an action, as reported by its actuator."""
        if report is not self._robot.report:
            return
        if not well:
            self.get_logger().warning(report.text)
        self._game.finish(cut_short=not well)

    def send_control(self, control: Control) -> None:
        """Publish control, and watch its holder and supervisor."""
        super().send_control(control)
        self._watch('')

    def pause(self, reason: str) -> None:
        """Stop the robot and refuse commands, or accept them again if the reason is empty."""
        self._game.pause(reason)
        super().pause(reason)
        self.report_progress()
        if reason:
            self.get_logger().warning(f'robot stopped: {reason}')

    def report_progress(self) -> None:
        """Publish the progress of the action under way."""
        under_way = self._game.under_way
        message = ActionProgress(stopped=self._game.paused or self._game.outside)
        if under_way is not None:
            command = under_way.command
            message.episode = self._game.transition.episode
            message.step = self._game.transition.step
            message.action, message.source = command.action, command.source
            message.seconds = max(self.now() - under_way.since, 0.0)
        message.feedback = self._robot.report.text
        self._progress_at = self.monotonic()
        self._progress.publish(message)

    def _watch(self, actor: str) -> None:
        control, under_way = self._game.control, self._game.under_way
        acting = under_way.command.publisher_id if under_way is not None else actor
        self._lively.watch(control.holder_id, control.supervisor_id, acting)

    def _on_lost(self, publisher_id: str) -> None:
        """Stop the robot because a process that acts or supervises has died or is stopped."""
        control, under_way = self._game.control, self._game.under_way
        if publisher_id in (control.holder_id, control.supervisor_id):
            reason = f'{signer(publisher_id)} was not heard for {LEASE:g} s'
            self.send_control(self._game.release(reason))
        elif under_way is not None and under_way.command.publisher_id == publisher_id:
            self._game.cut_short()

    def _on_emergency(self, message: Bool) -> None:
        pressed, self._emergency = message.data and not self._emergency, message.data
        if pressed and self.ready:
            self.send_control(self._game.lock('the emergency stop was pressed'))
        self._check()

    def _on_stop(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.send_control(self._game.lock('the service stop was called'))
        response.success, response.message = True, 'stopped; take control to continue'
        return response

    def _on_clock(self, message: Clock) -> None:
        self._simulated = message.clock.sec + message.clock.nanosec * 1e-9
        self._clock_at = self.monotonic()
        if self.ready and self._game.under_way is not None:
            self._tick()

    def _tick(self) -> None:
        """Check the robot, and continue its action."""
        if not self.ready:
            return
        self._check()
        if not self._game.transition.episode and not self._game.paused:
            self.begin_first_episode()  # the first messages may have been stale
        if self._game.under_way is not None:
            self._robot.repeat()
        self._game.tick()
        if self._game.under_way is None:
            self._drive.cancel()
        elif self.monotonic() - self._progress_at >= _PROGRESS_PERIOD:
            self.report_progress()

    def _check(self) -> None:
        """Stop the robot if there is a fault, and resume once it is gone."""
        if not self.ready or any(self._unsent.values()):
            return
        (fault, outside), game = self._faults(), self._game
        if fault.partition(':')[0] != game.paused.partition(':')[0]:
            self.pause(fault)
        if outside.partition(':')[0] != game.outside.partition(':')[0]:
            game.restrict(outside)
            self.report_progress()
            if outside:
                self.get_logger().warning(f'options and plans blocked: {outside}')

    def _faults(self) -> tuple[str, str]:
        """Return the reasons to forbid all motion, and to let only a person act; empty if none."""
        if self._by_clock and self.monotonic() - self._clock_at > _CLOCK_SILENCE:
            return 'use_sim_time is set, and no time arrives on /clock', ''
        if self._emergency:
            return 'the emergency stop is pressed', ''
        if self._others:
            return f'two worlds in one namespace: stop this one or {self._others[0]}', ''
        if self._rivals:
            return f'two worlds drive one robot: stop this one or {self._rivals[0]}', ''
        try:
            return '', self._robot.sense().outside
        except SensorError as error:
            return str(error), ''

    def _look_around(self) -> None:
        """Find other worlds, which would act on the same commands."""
        found = {*announced_ids(self, 'game')} - {self.publisher_id}
        self._twins.watch(*(each for each in found if signer(each) == signer(self.publisher_id)))
        # A killed world stays announced for a while; only its liveliness shows that it has ended.
        self._others = sorted(found - self._twins.lost)
        if (velocity := self._world.file.velocity_topic) is not None:
            drivers = {*publishers_of(self, self.resolve_topic_name(velocity.topic))}
            others = drivers - {self.get_fully_qualified_name()}
            self._rivals = sorted(name for name in others if name.endswith('/world'))
        self._check()

    def _missing(self, topic: Topic) -> str:
        """Describe the missing message of a topic."""
        name = self.resolve_topic_name(topic.topic)
        publishers = self.get_publishers_info_by_topic(name)
        other = sorted({each.topic_type for each in publishers} - {topic.type})
        if other:
            return f'{topic.topic} as {topic.type}: it is published as {other[0]}'
        text = f'a message on {topic.topic} ({topic.type})'
        if not publishers:
            return f'{text}: nothing publishes it'
        latched = any(
            each.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for each in publishers
        )
        return (
            f'{text}: it is latched, add latched: yes' if latched and not topic.latched else text
        )


# Not by_events: the EventsExecutor can crash when a liveliness callback destroys its subscription.
main = partial(run_node, WorldNode)

if __name__ == '__main__':
    sys.exit(main())
