"""The actuators of a robot: velocities, ROS actions, services and topics."""

from collections.abc import Callable, Mapping
from typing import Any

from action_msgs.msg import GoalStatus
from action_msgs.srv import CancelGoal
from humanopts_env.domains.base import DomainError
from humanopts_env.ros.interfaces import filled, interface
from humanopts_env.worlds.world_file import ActionSpec, Velocity, WorldFile
from humanopts_ros.limits import shown
from humanopts_ros.node_base import NodeBase
from humanopts_ros.qos import SERVICE, STREAM
from humanopts_ros.waiting import drive
from rclpy.action.client import ActionClient
from rclpy.client import Client

_SHOWN = 4  # maximum number of feedback fields shown
_CLEARING = 5.0  # s to wait for an action server at startup, and for its response


class Report:
    """
    The report of an actuator on one action.

    :ivar text: progress or result of the action, in words; empty: unknown.
    """

    def __init__(self, on_end: Callable[['Report', bool], object]) -> None:
        """
        Start without a text.

        :param on_end: callback for the end of the action, with this report and its success.
        """
        self._on_end, self.text = on_end, ''

    def ended(self, text: str, *, well: bool) -> None:
        """Record the end of the action, with a text about the result."""
        self.text = text
        self._on_end(self, well)


class Actuator:
    """
    Carries out one action of a world; this base class does nothing.

    :ivar clearing: event that is awaited before the action can begin; empty if none.
    """

    clearing = ''

    def start(self, report: Report) -> None:
        """
        Begin the action.

        :raises DomainError: the action cannot begin.
        """

    def repeat(self) -> None:
        """Do periodic work, about 20 times a second while the action lasts."""

    def stop(self) -> None:
        """Cancel the action, and report nothing more."""


class Drive(Actuator):
    """Sends a velocity while the action lasts."""

    def __init__(self, send: Callable[[Any, Any], None], spec: ActionSpec) -> None:
        assert spec.twist is not None
        self._send, self._vectors = send, spec.twist.vectors

    def start(self, report: Report) -> None:
        self.repeat()

    def repeat(self) -> None:
        self._send(*self._vectors)


class Velocities:
    """Publishes velocities, with or without a stamp."""

    def __init__(self, node: NodeBase, spec: Velocity) -> None:
        self._node, self._spec = node, spec
        self._kind = interface(self._spec.type)
        self._publisher = node.create_publisher(self._kind, self._spec.topic, 1)

    def send(self, linear: Any = (0.0, 0.0, 0.0), angular: Any = (0.0, 0.0, 0.0)) -> None:
        """Publish a velocity; by default 0, which stops the robot."""
        message = self._kind()
        twist = getattr(message, 'twist', message)
        for vector, values in ((twist.linear, linear), (twist.angular, angular)):
            vector.x, vector.y, vector.z = values
        if twist is not message:
            message.header.stamp = self._node.get_clock().now().to_msg()
            message.header.frame_id = self._spec.frame
        self._publisher.publish(message)


class Send(Actuator):
    """Publishes a message once."""

    def __init__(self, node: NodeBase, spec: ActionSpec, message: Any) -> None:
        self._publisher = node.create_publisher(type(message), str(spec.topic), STREAM)
        self._message = message

    def start(self, report: Report) -> None:
        self._publisher.publish(self._message)


class Call(Actuator):
    """Calls a service; a call cannot be canceled."""

    def __init__(self, node: NodeBase, spec: ActionSpec, kind: Any, request: Any) -> None:
        self._client = node.create_client(kind, str(spec.service), qos_profile=SERVICE)
        self._name, self._node, self._request = spec.service, node, request
        self._report: Report | None = None

    def start(self, report: Report) -> None:
        if not self._client.service_is_ready():
            raise DomainError(f'the service {self._name} is not there')
        self._report = report

        def answered(future: Any) -> None:
            if self._report is not report:  # stopped meanwhile
                return
            self._report, response = None, future.result()
            well = bool(getattr(response, 'success', True))
            said = getattr(response, 'message', '') or ('done' if well else 'it failed')
            report.ended(shown(f'{self._name}: {said}'), well=well)

        call = self._client.call_async(self._request)
        call.add_done_callback(self._node.guard.guarded(answered))

    def stop(self) -> None:
        self._report = None


class Act(Actuator):
    """Sends a goal to an action server."""

    def __init__(self, node: NodeBase, spec: ActionSpec, kind: Any, goal: Any) -> None:
        self._client = ActionClient(node, kind, str(spec.action))
        self._name, self._goal, self._guarded = spec.action, goal, node.guard.guarded
        self._report: Report | None = None
        self._handle: Any = None
        cancel = node.create_client(CancelGoal, f'{spec.action}/_action/cancel_goal')
        drive(self._clear(node, cancel))

    async def _clear(self, node: NodeBase, cancel: Client) -> None:
        """Cancel all goals, which a killed world may have sent, once the server is found."""
        found = await node.waiting.until(cancel.service_is_ready, _CLEARING)
        if found and self._report is None:
            self.clearing = f'{self._name} to cancel its goals'
            await node.waiting.answer(cancel, CancelGoal.Request(), _CLEARING)
            self.clearing = ''

    def start(self, report: Report) -> None:
        if not self._client.server_is_ready():
            raise DomainError(f'the action server {self._name} is not there')
        if self.clearing:
            raise DomainError(f'the robot waits for {self.clearing}')
        self._report, self._handle = report, None

        def on_feedback(message: Any) -> None:
            if self._report is report:
                report.text = summarised(message.feedback)

        def on_accepted(future: Any) -> None:
            handle = future.result()
            if self._report is not report:  # stopped before it was accepted
                if handle.accepted:
                    handle.cancel_goal_async()
            elif handle.accepted:
                self._handle = handle
                handle.get_result_async().add_done_callback(self._guarded(on_result))
            else:
                self._report = None
                report.ended(f'{self._name} rejected the goal', well=False)

        def on_result(future: Any) -> None:
            if self._report is not report:
                return
            self._report = self._handle = None
            status = future.result().status
            names = {getattr(GoalStatus, n): n for n in dir(GoalStatus) if n.startswith('STATUS_')}
            end = names.get(status, str(status)).removeprefix('STATUS_').lower()
            report.ended(f'{self._name} {end}', well=status == GoalStatus.STATUS_SUCCEEDED)

        sent = self._client.send_goal_async(
            self._goal, feedback_callback=self._guarded(on_feedback)
        )
        sent.add_done_callback(self._guarded(on_accepted))

    def stop(self) -> None:
        if self._handle is not None:
            self._handle.cancel_goal_async()
        self._report = self._handle = None


def make_actuators(
    node: NodeBase, file: WorldFile, velocities: Velocities | None
) -> Mapping[str, Actuator]:
    """
    Return the actuator of each action.

    :raises WorldFileError: a type is not installed, or a value does not fit it.
    """
    found: dict[str, Actuator] = {}
    for name, spec in file.actions.items():
        key = f'actions {name}'
        if spec.twist is not None and velocities is not None:
            found[name] = Drive(velocities.send, spec)
            continue
        kind = interface(spec.type)
        part = {'action': 'Goal', 'service': 'Request'}.get(spec.way)
        empty = getattr(kind, part)() if part else kind()
        message = filled(empty, spec.fields, file.places, key)
        if spec.way == 'action':
            found[name] = Act(node, spec, kind, message)
        elif spec.way == 'service':
            found[name] = Call(node, spec, kind, message)
        else:
            found[name] = Send(node, spec, message)
    return found


def summarised(message: Any) -> str:
    """Return the first numbers and texts of a message in words."""
    pairs = []
    for name in message.get_fields_and_field_types():
        value = getattr(message, name)
        if isinstance(value, bool | int | float | str):
            number = f'{value:.4g}' if isinstance(value, float) else value
            pairs.append(f'{name.replace("_", " ")} {number}')
    return shown(', '.join(pairs[:_SHOWN]))
