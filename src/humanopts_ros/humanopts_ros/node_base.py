"""The base class of all nodes: recorded endpoints, status, readiness, shutdown."""

from collections.abc import Callable, Coroutine
from contextlib import suppress
import functools
from itertools import chain
import os
import time
from typing import Any, ClassVar, TypeVar
import uuid
import weakref

from humanopts_interfaces.msg import NodeStatus
from humanopts_ros.guarded_node import failed_response, GuardedNode, STEADY
from humanopts_ros.middleware import INSTANCE, RESTARTS
from humanopts_ros.peers import Peers
from humanopts_ros.publisher import M, PublishError, StampedPublisher
from humanopts_ros.qos import ACTION, LATCHED, LIVELY, SERVICE, STREAM
from humanopts_ros.recording import Selection
from humanopts_ros.senders import id_topic, Role
from humanopts_ros.waiting import drive, Waiting
from humanopts_ros.workarounds import watch_time
from rclpy.action.server import (
    ActionServer,
    CancelResponse,
    GoalResponse,
    ServerGoalHandle,
)
from rclpy.client import Client
from rclpy.exceptions import InvalidHandle
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.service import Service
from rclpy.service_introspection import ServiceIntrospectionState
from std_msgs.msg import Empty

RECORDER = 'recorder'
RESULT_TIMEOUT = 10  # s to keep results of finished goals; kept goals slow down action statuses
_LAST_ROUNDS = 10  # number of callbacks run to send the last responses
_SHORT = 0.001  # s to wait for each callback; with 0, the ``EventsExecutor`` runs none
_DRAIN = 0.3  # s for readers to receive pending messages before a node ends
_REMARK_PERIOD = 1.0  # s between statuses that differ only in refusals or errors
_REPEAT_PERIOD = 1.0  # s between checks for competing publishers
_PROVISION = 5.0  # s, maximum time a request waits until the node is ready
_LATE = 5.0  # s after which a starting node reports what it is waiting for
_CHECK_PERIOD = 0.02  # s between checks during startup and shutdown
_SERVE_PERIOD = 1.0  # s, maximum wait of an idle node

E = TypeVar('E', Service, Client)


class _ActionServer(ActionServer):
    """
    Runs the coroutines of its goals with ``drive``, and sends the results when they are done.

    Otherwise, executors would check the future of every kept result at each event of the action.
    """

    def add_future(self, future: Any) -> None:
        """No-op."""

    def remove_future(self, future: Any) -> None:
        """No-op."""

    def notify_execute(self, goal_handle: ServerGoalHandle, execute_callback: Any) -> None:
        def finish(result: Any) -> None:
            ActionServer.notify_execute(self, goal_handle, lambda _: result)

        drive(self._execute_callback(goal_handle), finish)


class NodeBase(GuardedNode):
    """
    A node that publishes its readiness.

    The node is ready when ``waits_for`` returns None and, if a recorder is expected, the recorder
    has matched every publisher, so that the bag includes the first message.
    """

    role: ClassVar[Role] = 'node'
    drives: ClassVar[bool] = False  # whether it can drive a robot and announces its liveliness

    def __init__(
        self, name: str, *, monotonic: Callable[[], float] = time.monotonic, **options: Any
    ) -> None:
        """
        Declare the parameters common to all nodes, and publish that the node is starting.

        :param monotonic: clock for the node's deadlines, s.
        :param options: options of rclpy's Node, such as context and namespace.
        :raises StartError: a parameter is invalid.
        :raises MiddlewareError: the middleware cannot join the graph.
        """
        super().__init__(name, monotonic=monotonic, **options)
        instance = os.environ.pop(INSTANCE, '') or uuid.uuid4().hex[:8]
        self.publisher_id = f'{self.get_fully_qualified_name()}#{instance}'
        self._stamped: list[StampedPublisher[Any]] = []
        self._hidden: list[str] = []  # topics of services and actions
        self._repeated: list[StampedPublisher[Any]] = []
        self._repeat_timer = self.create_timer(_REPEAT_PERIOD, self._repeat, autostart=False)
        self._expect_recorder = self.setting(
            'expect_recorder', False, 'wait until the recorder has every publisher'
        )
        self.selection = Selection(
            self.get_namespace(),
            self._patterns('record_topics', 'topics to record beside those of the graph'),
            self._patterns('record_exclude', 'topics not to record'),
        )
        # Announce the publisher id before the first message.
        qos = LIVELY if self.drives else LATCHED
        self.create_publisher(Empty, id_topic(self.publisher_id, self.role), qos)
        self._restarts = int(os.environ.pop(RESTARTS, '0'))
        self._status = self.stamped_publisher(NodeStatus, 'node_status', LATCHED)
        self.ready = False
        self.failed = False  # exit with status 1 even after a normal shutdown
        self._own_state, self._own_text = NodeStatus.STATE_STARTING, ''
        self._remark_timer = self.create_timer(
            _REMARK_PERIOD, self._on_remark_timer, autostart=False
        )
        self._remark_sent = ''  # last published summary of refusals and errors
        self.set_status(NodeStatus.STATE_STARTING)
        self.waiting = Waiting(self, monotonic)
        # Not guarded: an error during startup ends the node.
        self._start_timer = Node.create_timer(self, _CHECK_PERIOD, self._try_start, clock=STEADY)
        self._begun = monotonic()
        self._start_fault: Exception | None = None
        watch_time(weakref.ref(self))

    @functools.cached_property
    def peers(self) -> Peers:
        """The nodes of this namespace, observed from the first access."""
        return Peers(self)

    def full_name(self, name: str) -> str:
        """Return the full name of a node in this namespace."""
        return f'{self.get_namespace().rstrip("/")}/{name}'

    def stamped_publisher(
        self,
        kind: type[M],
        topic: str,
        qos: QoSProfile = STREAM,
        on_matched: Callable[[Any], None] | None = None,
        *,
        repeated: bool = False,
    ) -> StampedPublisher[M]:
        """
        Create a publisher for messages with header, publisher_id and sequence.

        :param on_matched: callback for matched and unmatched subscriptions.
        :param repeated: whether to republish the newest message while there are other publishers.
        """
        event = on_matched and self.guard.guarded(on_matched)
        publisher = StampedPublisher(self, self.publisher_id, kind, topic, qos, event)
        self._stamped.append(publisher)
        if repeated:
            self._repeated.append(publisher)
            self._repeat_timer.reset()
        return publisher

    def _repeat(self) -> None:
        for publisher in self._repeated:
            if publisher.newest is not None and self.count_publishers(publisher.topic) > 1:
                publisher.publish(publisher.newest)

    def recorded_service(self, kind: Any, name: str, callback: Callable[..., Any]) -> Service:
        """Create a service that publishes its requests and responses on the graph."""
        service = self.create_service(kind, name, callback, qos_profile=SERVICE)
        return self._introspected(service, name)

    def recorded_client(self, kind: Any, name: str) -> Client:
        """Create a client that publishes its requests and responses on the graph."""
        client = self.create_client(kind, name, qos_profile=SERVICE)
        return self._introspected(client, name)

    def recorded_action(
        self,
        kind: Any,
        name: str,
        execute: Callable[[ServerGoalHandle], Coroutine[Any, Any, Any]],
        on_cancel: Callable[[ServerGoalHandle], object] = lambda handle: None,
        accepts: Callable[[Any], bool] = lambda goal: True,
    ) -> ActionServer:
        """
        Create an action server that accepts every cancel request.

        :param execute: coroutine function that waits only through ``waiting``.
        :param on_cancel: callback invoked with the goal handle just before the goal is canceled.
        :param accepts: function that returns whether to accept a goal.
        """
        self._hidden += [f'{name}/_action/feedback', f'{name}/_action/status']

        def failed(text: str, handle: ServerGoalHandle) -> Any:
            if handle.is_active:
                handle.abort()
            return failed_response(kind.Result(), text)

        def cancel(handle: ServerGoalHandle) -> CancelResponse:
            self.guard.guarded(on_cancel)(handle)
            return CancelResponse.ACCEPT

        def answer(goal: Any) -> GoalResponse:
            accepted = self.guard.guarded(accepts)(goal)
            return GoalResponse.ACCEPT if accepted else GoalResponse.REJECT

        return _ActionServer(  # type: ignore[no-untyped-call]
            self,
            kind,
            name,
            self.guard.guarded(execute, failed),
            goal_callback=answer,
            cancel_callback=cancel,
            result_timeout=RESULT_TIMEOUT,
            **ACTION,
        )

    def is_recorded(self, topic: str, recorders: int = 1) -> bool:
        """Return whether enough recorders subscribe to a topic, or it is not to be recorded."""
        if not self.selection.wants_own(self.resolve_topic_name(topic)):
            return True
        readers = self.get_subscriptions_info_by_topic(topic)
        return len([1 for reader in readers if reader.node_name == RECORDER]) >= recorders

    def records(self, publisher: StampedPublisher[Any], recorders: int = 1) -> bool:
        """Return whether all subscriptions are matched and the topic is recorded."""
        return publisher.is_matched() and self.is_recorded(publisher.topic, recorders)

    def is_fully_recorded(self) -> bool:
        """Return whether the recorder, if expected, receives all of this node's messages."""
        return self._lacks_recorder() is None

    async def provided(self) -> bool:
        """Wait until ``waits_for`` returns None; return whether this happened in time."""
        return await self.waiting.until(lambda: self.waits_for() is None, _PROVISION)

    def set_status(self, state: int, text: str = '') -> None:
        """
        Publish the node's state and a summary of refusals and errors.

        A failure to publish is only logged.

        :param text: reason for the state; empty if none.
        """
        self._own_state, self._own_text, self._remark_sent = state, text, self.guard.remark
        whole = '; '.join(filter(None, (text, self._remark_sent)))
        name, restarts = self.get_fully_qualified_name(), self._restarts
        status = NodeStatus(state=state, node=name, text=whole, restarts=restarts)
        try:
            self._status.publish(status)
        except PublishError as error:
            self.get_logger().error(str(error))

    def publish_status_again(self) -> None:
        """Republish the node's state as a heartbeat."""
        self.set_status(self._own_state, self._own_text)

    def waits_for(self) -> str | None:
        """Describe what the node is waiting for; None if nothing. To be overridden."""
        return None

    def on_ready(self) -> None:
        """Handle readiness, for example by publishing an initial state. To be overridden."""

    def serve(self, executor: Executor, stop: Callable[[], bool]) -> None:
        """Run callbacks until ``stop`` returns True. May be overridden to read input."""
        while not stop():
            self.turn(executor, _SERVE_PERIOD)

    def turn(self, executor: Executor, seconds: float) -> None:
        """
        Wait for one callback and run it.

        Errors also come from callbacks of futures and from messages that cannot be deserialised.
        """
        try:
            executor.spin_once(seconds)
        except Exception as error:
            if error is self._start_fault:
                raise
            self.guard.caught('the executor', error)

    def close(self) -> None:
        """Finish pending work before the node ends. To be overridden."""

    def finish(self, busy: Callable[[], bool], seconds: float) -> None:
        """Run callbacks until ``busy`` returns False or time is up, then send the responses."""
        deadline, executor = time.monotonic() + seconds, self.executor
        assert executor is not None, 'the node serves, or did'
        while busy() and time.monotonic() < deadline:
            self.turn(executor, _CHECK_PERIOD)
        for _ in range(_LAST_ROUNDS):
            self.turn(executor, _SHORT)

    def drain(self) -> None:
        """Wait briefly for the readers to receive pending messages."""
        deadline = time.monotonic() + _DRAIN
        for publisher in self._stamped:
            publisher.drain(max(0.0, deadline - time.monotonic()))

    def _introspected(self, endpoint: E, name: str) -> E:
        contents = ServiceIntrospectionState.CONTENTS
        endpoint.configure_introspection(self.get_clock(), STREAM, contents)
        self._hidden.append(f'{name}/_service_event')
        return endpoint

    def _patterns(self, name: str, description: str) -> tuple[str, ...]:
        given = self.setting(name, [''], f'patterns of {description}')
        return tuple(pattern for pattern in given if pattern)

    def _on_remark(self) -> None:
        """Publish refusals and errors, at a limited rate."""
        if self._remark_timer.is_canceled():
            self._remark_timer.reset()
            self.publish_status_again()

    def _on_remark_timer(self) -> None:
        if self._remark_sent == self.guard.remark:
            self._remark_timer.cancel()
        else:
            self.publish_status_again()

    def notify_time_set(self, seconds: float) -> None:
        """Handle and log a change of the system time; thread-safe."""
        if (executor := self.executor) is not None:
            with suppress(InvalidHandle, AttributeError):  # it may just have been shut down
                executor.create_task(self.guard.guarded(self._on_time_set), seconds)

    def _on_time_set(self, seconds: float) -> None:
        if self.destroyed:
            return
        self.get_logger().warning(f'the time of day was set by {seconds:+.3f} s')
        self.publish_status_again()  # sending also wakes the middleware's threads

    def _try_start(self) -> None:
        try:
            self._check_start()
        except Exception as error:
            self._start_fault = error
            raise

    def _check_start(self) -> None:
        missing = self.waits_for() or self._lacks_recorder()
        if missing is not None:
            text = f'waits for {missing}'
            if self.monotonic() - self._begun > _LATE and text != self._own_text:
                self.set_status(NodeStatus.STATE_STARTING, text)
                self.get_logger().warning(text)
            return
        self._start_timer.cancel()
        if self._expect_recorder:
            self.drain()  # before the next status replaces the first one
        self.ready = True
        self.on_ready()
        self.set_status(NodeStatus.STATE_READY)
        self.get_logger().info('ready')

    def _lacks_recorder(self) -> str | None:
        """Describe a topic that the recorder lacks; None if none, or no recorder is expected."""
        if not self._expect_recorder:
            return None
        missing = chain(
            (each.topic for each in self._stamped if not self.records(each)),
            (topic for topic in self._hidden if not self.is_recorded(topic)),
        )
        topic = next(missing, None)
        return None if topic is None else f'the recorder to subscribe to {topic}'


def end_goal(handle: ServerGoalHandle, good: bool, canceled: bool) -> None:
    """Set the final state of an action goal: succeeded, canceled by the client, or aborted."""
    if good:
        handle.succeed()
    elif canceled:
        handle.canceled()
    else:
        handle.abort()
