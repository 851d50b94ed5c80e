"""What every humanopts node shares: stamped publishers, readiness, a clean start and end."""

from collections.abc import Callable
import os
import signal
import sys
import time
from types import FrameType
from typing import Any, Generic, TypeVar
import uuid

from humanopts_interfaces.msg import NodeStatus
from humanopts_ros.environment import LAUNCHER_PID, prepare_discovery
from humanopts_ros.qos import LATCHED, STREAM
from humanopts_ros.recording import Selection
from humanopts_ros.waiting import Waiting
from rcl_interfaces.msg import ParameterDescriptor
import rclpy
from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import CallbackGroup, ReentrantCallbackGroup
from rclpy.client import Client
from rclpy.duration import Duration
from rclpy.exceptions import ParameterException
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.service import Service
from rclpy.service_introspection import ServiceIntrospectionState
from rclpy.signals import SignalHandlerOptions

M = TypeVar('M')
RECORDER = 'recorder'
_RESULT_TIMEOUT = 10  # s that a finished goal's result is kept; each costs time in every status
_LAST_ROUNDS = 10  # callbacks that are carried out for the last answers
_DRAIN = 0.3  # s that readers have to take what was sent, before a node ends
_PRESENCE_PERIOD = 1.0  # s between looks whether a server that was asked is still there
_PROVISION = 5.0  # s that a request waits for what its server still needs
_CHECK_PERIOD = 0.02  # s between looks at what the start or the end of a node waits for


class StartError(RuntimeError):
    """A node cannot start with these parameters; the text says which and why."""


class PublishError(RuntimeError):
    """A message could not be sent; the text names the topic and the cause."""


class StampedPublisher(Generic[M]):
    """Publishes on one topic, filling in header, publisher_id and sequence."""

    def __init__(self, node: 'NodeBase', kind: type[M], topic: str, qos: QoSProfile) -> None:
        self._node = node
        self._publisher: Publisher = node.create_publisher(kind, topic, qos)
        self.sequence = 0  # of the last message that was sent

    @property
    def topic(self) -> str:
        """Full name of the topic."""
        return str(self._publisher.topic_name)

    def stamp(self, message: M) -> M:
        """Fill in the fields that ``publish`` would, without sending."""
        filled: Any = message
        filled.header.stamp = self._node.get_clock().now().to_msg()
        filled.publisher_id = self._node.publisher_id
        filled.sequence = self.sequence + 1
        return message

    def publish(self, message: M) -> None:
        """
        Send the message.

        :raises PublishError: the middleware refused it, as it does when a reader that keeps
            everything has stopped reading.
        """
        try:
            self._publisher.publish(self.stamp(message))
        except Exception as error:
            raise PublishError(self._why(error)) from error
        self.sequence += 1

    def recorded(self, recorders: int = 1) -> bool:
        """Tell whether the subscriptions of so many recorders are matched."""
        readers = self._node.get_subscriptions_info_by_topic(self.topic)
        matched = self._publisher.get_subscription_count() >= len(readers)
        return matched and self._node.is_recorded(self.topic, recorders)

    def heard_by(self, node_name: str) -> bool:
        """Tell whether a node's subscription is matched, so that a message would arrive."""
        readers = self._node.get_subscriptions_info_by_topic(self.topic)
        matched = self._publisher.get_subscription_count() >= len(readers)
        return matched and any(reader.node_name == node_name for reader in readers)

    def drain(self, seconds: float) -> None:
        """Wait for the readers to take what was sent."""
        self._publisher.wait_for_all_acked(Duration(seconds=seconds))

    def _why(self, error: Exception) -> str:
        """Name the readers, since one of them that has stopped is the usual cause."""
        readers = self._node.get_subscriptions_info_by_topic(self.topic)
        names = ', '.join(sorted({reader.node_name for reader in readers})) or 'none'
        cause = _plain(error)
        return f'cannot publish on {self.topic}: {cause}; has a reader stopped? They are: {names}'


class NodeBase(Node):
    """
    A node that says when it is ready.

    It is ready once nothing is left that it ``waits_for`` and, where a recorder is expected, the
    recorder has matched every publisher, so that the first message is in the bag.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.publisher_id = f'{self.get_fully_qualified_name()}#{uuid.uuid4().hex[:8]}'
        self._stamped: list[StampedPublisher[Any]] = []
        self._hidden: list[str] = []  # topics of services and actions
        self._expect_recorder = bool(
            self.setting('expect_recorder', False, 'wait until the recorder has every publisher')
        )
        self.selection = Selection(
            self.get_namespace(),
            self._patterns('record_include', 'topics to record, as lesson/*; none: all'),
            self._patterns('record_exclude', 'topics not to record'),
        )
        self._status = self.stamped_publisher(NodeStatus, 'node_status', LATCHED)
        self.ready = False
        self.failed = False  # the process ends with status 1, though it came to its end
        self.set_status(NodeStatus.STATE_STARTING)
        self._deadline_group = ReentrantCallbackGroup()
        self.waiting = Waiting(self)  # of this node's coroutines
        self._start_timer = self.create_timer(_CHECK_PERIOD, self._check_start)

    def setting(self, name: str, default: Any, description: str, **limits: Any) -> Any:
        """
        Declare a read-only parameter and return its value.

        :param limits: further fields of its ParameterDescriptor.
        :raises StartError: the value given at start has the wrong type or is out of range.
        """
        descriptor = ParameterDescriptor(description=description, read_only=True, **limits)
        try:
            return self.declare_parameter(name, default, descriptor).value
        except ParameterException as error:
            raise StartError(f'parameter {name}: {error}') from error

    def stamped_publisher(
        self, kind: type[M], topic: str, qos: QoSProfile = STREAM
    ) -> StampedPublisher[M]:
        """Create a publisher of a message with header, publisher_id and sequence."""
        publisher = StampedPublisher(self, kind, topic, qos)
        self._stamped.append(publisher)
        return publisher

    def recorded_service(
        self,
        kind: Any,
        name: str,
        callback: Callable[..., Any],
        group: CallbackGroup | None = None,
    ) -> Service:
        """Create a service whose requests and responses are on the graph."""
        service = self.create_service(kind, name, callback, callback_group=group)
        service.configure_introspection(
            self.get_clock(), STREAM, ServiceIntrospectionState.CONTENTS
        )
        self._hidden.append(f'{name}/_service_event')
        return service

    def recorded_client(self, kind: Any, name: str, group: CallbackGroup | None = None) -> Client:
        """Create a client whose requests and responses are on the graph."""
        client = self.create_client(kind, name, callback_group=group)
        client.configure_introspection(
            self.get_clock(), STREAM, ServiceIntrospectionState.CONTENTS
        )
        self._hidden.append(f'{name}/_service_event')
        return client

    def recorded_action(
        self,
        kind: Any,
        name: str,
        execute: Callable[..., Any],
        group: CallbackGroup,
        on_cancel: Callable[[ServerGoalHandle], object] = lambda handle: None,
    ) -> ActionServer:
        """
        Create an action server that accepts every goal and every cancel.

        :param on_cancel: told the handle of the goal, just before the handle says so itself.
        """
        self._hidden += [f'{name}/_action/feedback', f'{name}/_action/status']

        def cancel(handle: ServerGoalHandle) -> CancelResponse:
            on_cancel(handle)
            return CancelResponse.ACCEPT

        return ActionServer(
            self,
            kind,
            name,
            execute,
            callback_group=group,
            cancel_callback=cancel,
            result_timeout=_RESULT_TIMEOUT,
        )

    def is_recorded(self, topic: str, recorders: int = 1) -> bool:
        """Tell whether so many recorders subscribe to a topic, or are told to leave it out."""
        if not self.selection.wants(self.resolve_topic_name(topic)):
            return True
        readers = self.get_subscriptions_info_by_topic(topic)
        return sum(reader.node_name == RECORDER for reader in readers) >= recorders

    async def answer(self, client: Client, request: Any, seconds: float) -> Any:
        """
        Call a service from a coroutine.

        A request that is sent before the server is found is lost, so that is waited for.

        :return: the response; None when there is none after ``seconds``, or the server is gone.
        """
        if not await self.waiting.until(client.service_is_ready, min(seconds, _PRESENCE_PERIOD)):
            return None
        future, deadline = client.call_async(request), time.monotonic() + seconds

        def check() -> None:
            if time.monotonic() >= deadline or not client.service_is_ready():
                future.cancel()

        timer = self.create_timer(
            min(seconds, _PRESENCE_PERIOD), check, callback_group=self._deadline_group
        )
        try:
            return await future
        finally:
            timer.cancel()
            self.destroy_timer(timer)
            client.remove_pending_request(future)

    async def provided(self) -> bool:
        """Wait in a coroutine for what the node ``waits_for``; False: it did not come."""
        return await self.waiting.until(lambda: self.waits_for() is None, _PROVISION)

    def set_status(self, state: int, text: str = '') -> None:
        """Publish the node's state; a failure to do so is only logged."""
        status = NodeStatus(state=state, node=self.get_fully_qualified_name(), text=text)
        try:
            self._status.publish(status)
        except PublishError as error:
            self.get_logger().error(str(error))

    def waits_for(self) -> str | None:
        """Say what the node still needs before it is ready; None: nothing. To be overridden."""
        return None

    def on_ready(self) -> None:
        """Do what comes first, such as publishing a first state. To be overridden."""

    def serve(self, executor: Executor, stop: Callable[[], bool]) -> None:
        """Carry out callbacks until ``stop``. To be overridden by a node that reads more."""
        while not stop():
            executor.spin_once(0.1)

    def close(self) -> None:
        """Finish work before the node ends. To be overridden."""

    def finish(self, busy: Callable[[], bool], seconds: float) -> None:
        """Carry out callbacks until nothing is under way and the answers to it are sent."""
        deadline = time.monotonic() + seconds
        while busy() and time.monotonic() < deadline:
            self.executor.spin_once(_CHECK_PERIOD)
        for _ in range(_LAST_ROUNDS):
            self.executor.spin_once(0.0)

    def drain(self) -> None:
        """Wait a moment for the readers to take what was sent."""
        deadline = time.monotonic() + _DRAIN
        for publisher in self._stamped:
            publisher.drain(max(0.0, deadline - time.monotonic()))

    def _patterns(self, name: str, description: str) -> tuple[str, ...]:
        given = self.setting(name, [''], f'patterns of {description}')
        return tuple(pattern for pattern in given if pattern)

    def _check_start(self) -> None:
        if self.waits_for() is not None:
            return
        if self._expect_recorder and not (
            all(publisher.recorded() for publisher in self._stamped)
            and all(self.is_recorded(topic) for topic in self._hidden)
        ):
            return
        self._start_timer.cancel()
        self.ready = True
        self.on_ready()
        self.set_status(NodeStatus.STATE_READY)


class _Stop:
    """Set by SIGINT, SIGTERM or SIGHUP, or when the launcher that started the process is gone."""

    def __init__(self) -> None:
        self.requested = False
        self._launcher = int(os.environ.get(LAUNCHER_PID, '0'))
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, self._request)

    def _request(self, signum: int, frame: FrameType | None) -> None:
        self.requested = True

    def __call__(self) -> bool:
        """Tell whether the process is to end."""
        return self.requested or (self._launcher != 0 and os.getppid() != self._launcher)


def _plain(error: Exception) -> str:
    """Return the text of an error without the places in the source of rcl."""
    return str(error).split(', at /')[0]


def run_node(factory: Callable[[], NodeBase], args: list[str] | None = None) -> int:
    """
    Run a node until SIGINT, SIGTERM or SIGHUP.

    The node is closed however it ends. An error that nobody expected goes on to the caller, so
    that the traceback is shown and the exit status is 1.

    :return: the process's exit status: 0 after a clean end, 2 when it cannot start, 1 when it
        cannot go on.
    """
    stop = _Stop()
    prepare_discovery()
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # such as arguments that it cannot read
        print(f'humanopts: ROS cannot start: {_plain(error)}', file=sys.stderr)
        return 2
    executor = SingleThreadedExecutor()
    node: NodeBase | None = None
    try:
        node = factory()
        executor.add_node(node)
        try:
            node.serve(executor, stop)
        finally:  # whatever ended it, so that its files are complete
            node.close()
        node.set_status(NodeStatus.STATE_STOPPING)
        node.drain()
    except StartError as error:
        print(f'humanopts: {error}', file=sys.stderr)
        return 2
    except PublishError as error:
        print(f'humanopts: {error}', file=sys.stderr)
        return 1
    except ExternalShutdownException:
        pass
    finally:
        executor.shutdown()
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return int(node is not None and node.failed)
