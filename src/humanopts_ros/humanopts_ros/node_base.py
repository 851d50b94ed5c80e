"""The base class of all nodes: parameters, recorded endpoints, readiness, waiting, shutdown."""

from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
import functools
from itertools import chain
import os
import time
from typing import Any, ClassVar, TypeVar
import uuid
import weakref

from humanopts_interfaces.msg import NodeStatus
from humanopts_ros.guard import Guard
from humanopts_ros.middleware import INSTANCE, MiddlewareError, RESTARTS
from humanopts_ros.peers import node_names, Peers
from humanopts_ros.publisher import M, PublishError, StampedPublisher, without_source
from humanopts_ros.qos import ACTION, LATCHED, SERVICE, STREAM
from humanopts_ros.recording import Selection
from humanopts_ros.senders import id_topic, Role, sender_of, signer
from humanopts_ros.workarounds import prepare_discovery, watch_time
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
import rclpy
from rclpy.action.server import ActionServer, CancelResponse, ServerGoalHandle
from rclpy.callback_groups import CallbackGroup, ReentrantCallbackGroup
from rclpy.client import Client
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.context import Context
from rclpy.exceptions import InvalidHandle, ParameterException
from rclpy.executors import Executor, ExternalShutdownException
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.service import Service
from rclpy.service_introspection import ServiceIntrospectionState
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from rclpy.task import Future
from rclpy.timer import Timer
from std_msgs.msg import Empty

RECORDER = 'recorder'
SEEDS = (0, 2**62)
PATIENCE = (0.1, 3600.0)  # s, range of deadlines
_RESULT_TIMEOUT = 10  # s to keep the result of a finished goal; kept goals slow down each status
_LAST_ROUNDS = 10  # number of callbacks run to send the last responses
_DRAIN = 0.3  # s, time for readers to receive pending messages before a node ends
_PRESENCE_PERIOD = 1.0  # s between checks that the server of a request still exists
_REMARK_PERIOD = 1.0  # s between statuses that differ only in refusals or errors
_REPEAT_PERIOD = 1.0  # s between checks for competing publishers of a node's current values
_PROVISION = 5.0  # s, maximum time a request waits until the node is ready
_LATE = 5.0  # s after which a starting node reports what it is waiting for
_CHECK_PERIOD = 0.02  # s between checks during startup, shutdown and waits of coroutines
_STEADY = Clock(clock_type=ClockType.STEADY_TIME)


T = TypeVar('T')
V = TypeVar('V')
D = TypeVar('D', bound=Any)  # a dataclass
E = TypeVar('E', Service, Client)
Range = tuple[float, float]  # minimum and maximum


class StartError(RuntimeError):
    """A node cannot start with these parameters; the message names the parameter and reason."""


@contextmanager
def starting_ros() -> Iterator[None]:
    """
    Convert an error of rclpy into a one-line MiddlewareError.

    :raises MiddlewareError: ROS cannot start.
    """
    try:
        yield
    except RuntimeError as error:  # such as invalid arguments
        raise MiddlewareError(f'ROS cannot start: {without_source(error)}') from error


def start_ros(args: list[str] | None = None, context: Context | None = None) -> None:
    """
    Start ROS with the environment's settings; signal handling is left to the caller.

    :param args: command-line arguments.
    :param context: rclpy context; None: the default context.
    :raises MiddlewareError: ROS cannot start.
    """
    prepare_discovery()
    with starting_ros():
        options = SignalHandlerOptions.NO
        rclpy.init(args=args, context=context, signal_handler_options=options)


class Waiting:
    """
    Lets a node's coroutines wait for conditions.

    The coroutines must be in a reentrant callback group. Pending conditions are checked
    periodically; ``check`` checks them immediately.
    """

    def __init__(self, node: Node, monotonic: Callable[[], float]) -> None:
        """
        Start without conditions.

        :param monotonic: clock for deadlines, s.
        """
        self._node, self._monotonic = node, monotonic
        self._open: list[tuple[Future, Callable[[], bool], float]] = []
        self._timer = node.create_timer(
            _CHECK_PERIOD, self.check, callback_group=ReentrantCallbackGroup(), autostart=False
        )

    def check(self) -> None:
        """Wake coroutines with a true condition or an expired deadline."""
        now = self._monotonic()
        still = []
        for entry in self._open:
            future, condition, deadline = entry
            try:
                if condition() or now > deadline:
                    future.set_result(None)
                else:
                    still.append(entry)
            except Exception as error:  # raised in the waiting coroutine
                future.set_exception(error)
        self._open = still
        if not still:
            self._timer.cancel()

    async def until(self, condition: Callable[[], bool], seconds: float) -> bool:
        """Wait until a condition is true; return whether it became true in time."""
        deadline = self._monotonic() + seconds
        while not condition():  # may be false again when the coroutine resumes
            if self._monotonic() > deadline:
                return False
            future = Future(executor=self._node.executor)
            self._open.append((future, condition, deadline))
            if self._timer.is_canceled():
                self._timer.reset()
            await future
        return True


class NodeBase(Node):
    """
    A node that publishes its readiness.

    The node is ready when ``waits_for`` returns None and, if a recorder is expected, the recorder
    has matched every publisher, so that the bag includes the first message.

    Callbacks are guarded: invalid messages are dropped and unexpected errors logged; both are
    counted in the node's status, and the node continues. After an error, services and actions
    respond with a status and a text.
    """

    role: ClassVar[Role] = 'node'

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
        ends = StartError, ExternalShutdownException
        self.guard = Guard(self.get_logger, monotonic, self._publish_remark, ends)
        with starting_ros():
            super().__init__(name, **options)
        self.monotonic = monotonic
        instance = os.environ.pop(INSTANCE, '') or uuid.uuid4().hex[:8]
        self.publisher_id = f'{self.get_fully_qualified_name()}#{instance}'
        self._stamped: list[StampedPublisher[Any]] = []
        self._hidden: list[str] = []  # topics of services and actions
        self._repeated: list[StampedPublisher[Any]] = []
        self._repeat_timer = self.create_timer(_REPEAT_PERIOD, self._repeat, autostart=False)
        self._on_change: dict[str, Callable[[Any], object]] = {}  # by parameter name
        self.add_post_set_parameters_callback(self.guard.guarded(self._on_parameters))
        self._expect_recorder = self.setting(
            'expect_recorder', False, 'wait until the recorder has every publisher'
        )
        self.selection = Selection(
            self.get_namespace(),
            self._patterns('record_topics', 'topics to record beside those of the graph'),
            self._patterns('record_exclude', 'topics not to record'),
        )
        # Announce the publisher id before the first message.
        self.create_publisher(Empty, id_topic(self.publisher_id, self.role), LATCHED)
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
        self.waiting = Waiting(self, monotonic)  # for this node's coroutines
        # Not guarded: an error during startup ends the node.
        self._start_timer = super().create_timer(_CHECK_PERIOD, self._try_start, clock=_STEADY)
        self._begun = monotonic()
        self._start_fault: Exception | None = None
        self.destroyed = False
        watch_time(weakref.ref(self))

    def get_logger(self) -> RcutilsLogger:
        logger: RcutilsLogger = super().get_logger()  # type: ignore[no-untyped-call]
        return logger

    def destroy_node(self) -> None:
        self.destroyed = True
        super().destroy_node()  # type: ignore[no-untyped-call]

    def create_timer(
        self, timer_period_sec: float, callback: Callable[..., Any], *args: Any, **options: Any
    ) -> Timer:
        """Create a timer with a guarded callback and a steady clock."""
        guarded, options['clock'] = self.guard.guarded(callback), _STEADY
        return super().create_timer(timer_period_sec, guarded, *args, **options)

    def create_subscription(
        self,
        msg_type: Any,
        topic: str,
        callback: Callable[..., Any],
        qos_profile: QoSProfile | int,
        **options: Any,
    ) -> Subscription:
        """
        Create a subscription with a guarded callback.

        If ``senders`` allows only one publisher, messages from other nodes are refused.
        """
        sender = sender_of(self.resolve_topic_name(topic), self.get_namespace())

        @functools.wraps(callback)
        def use(message: Any) -> None:
            if sender and signer(message.publisher_id) != sender:
                self.refuse(topic, message, f'it is not from {sender}')
            else:
                callback(message)

        guarded = self.guard.guarded(use)
        return super().create_subscription(msg_type, topic, guarded, qos_profile, **options)

    def create_service(
        self, srv_type: Any, srv_name: str, callback: Callable[..., Any], **options: Any
    ) -> Service:
        """Create a service with a guarded callback that always responds."""

        def failed(text: str, request: Any, response: Any) -> Any:
            return _failed(srv_type.Response(), text)

        guarded = self.guard.guarded(callback, failed)
        return super().create_service(srv_type, srv_name, guarded, **options)

    def subscribe(
        self,
        kind: type[T],
        topic: str,
        read: Callable[[T], V | None],
        use: Callable[[V], object],
        qos: QoSProfile = STREAM,
    ) -> Subscription:
        """
        Subscribe to a topic and convert its messages to values.

        :param read: function that returns the value of a message, or None to ignore it; a
            ValueError with a reason refuses the message.
        :param use: callback for each value.
        """

        @functools.wraps(use)
        def on_message(message: T) -> None:
            value = self.accepted(topic, read, message)
            if value is not None:
                use(value)

        return self.create_subscription(kind, topic, on_message, qos)

    @functools.cached_property
    def peers(self) -> Peers:
        """The nodes of this namespace, observed from the first access."""
        return Peers(self)

    def full_name(self, name: str) -> str:
        """Return the full name of a node of this namespace."""
        return f'{self.get_namespace().rstrip("/")}/{name}'

    def nodes_there(self) -> list[str]:
        """Return the full names of all nodes on the graph; any process may use any name."""
        return node_names(self)

    def accepted(self, topic: str, read: Callable[[T], V | None], message: T) -> V | None:
        """Return the value of a message; None: the message is refused or ignored."""
        try:
            return read(message)
        except ValueError as error:
            self.refuse(topic, message, error)
            return None

    def refuse(self, topic: str, message: Any, reason: object) -> None:
        """Drop a message or a part of it: count and log it, and report it in the status."""
        self.guard.refuse(topic, getattr(message, 'publisher_id', ''), reason)

    def setting(
        self,
        name: str,
        default: T,
        description: str,
        between: Range | None = None,
        among: Collection[str] = (),
        on_change: Callable[[T], object] | None = None,
    ) -> T:
        """
        Declare a parameter and return its value.

        :param between: range of a number; None: any.
        :param among: allowed texts; empty: any.
        :param on_change: callback for each valid value set at runtime; None: the parameter is
            read-only.
        :raises StartError: the initial value has the wrong type or is not allowed.
        """
        descriptor = ParameterDescriptor(description=description, read_only=on_change is None)
        if between is not None:
            low, high = between
            if isinstance(default, int):
                whole = IntegerRange(from_value=int(low), to_value=int(high), step=1)
                descriptor.integer_range = [whole]
            else:
                real = FloatingPointRange(from_value=float(low), to_value=float(high))
                descriptor.floating_point_range = [real]
        try:
            value: T = self.declare_parameter(name, default, descriptor).value
        except ParameterException as error:
            raise StartError(f'parameter {name}: {error}') from error
        if among and value not in among:
            raise StartError(f'parameter {name}: {value!r} is none of {", ".join(among)}')
        if on_change is not None:
            self._on_change[name] = on_change
        return value

    def settings(
        self, defaults: D, descriptions: Mapping[str, str], between: Mapping[str, Range]
    ) -> D:
        """
        Declare parameters for selected fields of a dataclass, and return it with their values.

        :param defaults: dataclass instance with the default values.
        :param descriptions: parameter descriptions by field.
        :param between: ranges of some fields; other fields accept any value.
        :raises StartError: as in ``setting``.
        """
        values = {
            name: self.setting(name, getattr(defaults, name), text, between.get(name))
            for name, text in descriptions.items()
        }
        return replace(defaults, **values)

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

        :param on_matched: callback invoked when a subscription is matched or unmatched.
        :param repeated: whether to republish the newest message while other publishers compete.
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

    def recorded_service(
        self,
        kind: Any,
        name: str,
        callback: Callable[..., Any],
        group: CallbackGroup | None = None,
    ) -> Service:
        """Create a service that publishes its requests and responses on the graph."""
        service = self.create_service(
            kind, name, callback, qos_profile=SERVICE, callback_group=group
        )
        return self._introspected(service, name)

    def recorded_client(self, kind: Any, name: str, group: CallbackGroup | None = None) -> Client:
        """Create a client that publishes its requests and responses on the graph."""
        client = self.create_client(kind, name, qos_profile=SERVICE, callback_group=group)
        return self._introspected(client, name)

    def recorded_action(
        self,
        kind: Any,
        name: str,
        execute: Callable[..., Any],
        group: CallbackGroup,
        on_cancel: Callable[[ServerGoalHandle], object] = lambda handle: None,
    ) -> ActionServer:
        """
        Create an action server that accepts every goal and every cancel request.

        :param on_cancel: callback invoked with the goal handle just before the goal is canceled.
        """
        self._hidden += [f'{name}/_action/feedback', f'{name}/_action/status']

        def failed(text: str, handle: ServerGoalHandle) -> Any:
            if handle.is_active:
                handle.abort()
            return _failed(kind.Result(), text)

        def cancel(handle: ServerGoalHandle) -> CancelResponse:
            self.guard.guarded(on_cancel)(handle)
            return CancelResponse.ACCEPT

        return ActionServer(
            self,
            kind,
            name,
            self.guard.guarded(execute, failed),
            callback_group=group,
            cancel_callback=cancel,
            result_timeout=_RESULT_TIMEOUT,
            **ACTION,
        )

    def is_recorded(self, topic: str, recorders: int = 1) -> bool:
        """Return whether this many recorders subscribe to a topic, or it is not recorded."""
        if not self.selection.wants_own(self.resolve_topic_name(topic)):
            return True
        readers = self.get_subscriptions_info_by_topic(topic)
        return len([1 for reader in readers if reader.node_name == RECORDER]) >= recorders

    def records(self, publisher: StampedPublisher[Any], recorders: int = 1) -> bool:
        """Return whether this many recorders have matched subscriptions."""
        return publisher.is_matched() and self.is_recorded(publisher.topic, recorders)

    def is_recorded_whole(self) -> bool:
        """Return whether the recorder, if any, receives all of this node's messages."""
        return self._lacks_recorder() is None

    async def answer(
        self,
        client: Client,
        request: Any,
        seconds: float,
        lost: Callable[[], bool] = lambda: False,
    ) -> Any:
        """
        Call a service from a coroutine.

        A request sent before the server is discovered is lost, so this waits for the server.

        :param lost: function that returns whether the server has restarted and lost the request.
        :return: the response; None: there is none after ``seconds``, or the server is gone.
        """
        if not await self.waiting.until(client.service_is_ready, min(seconds, _PRESENCE_PERIOD)):
            return None
        future, deadline = client.call_async(request), self.monotonic() + seconds

        def check() -> None:
            if self.monotonic() >= deadline or lost() or not client.service_is_ready():
                future.cancel()

        group = ReentrantCallbackGroup()  # a new group: groups never release their members
        timer = self.create_timer(min(seconds, _PRESENCE_PERIOD), check, callback_group=group)
        try:
            return await future
        finally:
            with suppress(InvalidHandle):  # the node may have been destroyed
                timer.cancel()
                self.destroy_timer(timer)
                client.remove_pending_request(future)

    async def provided(self) -> bool:
        """Wait until ``waits_for`` returns None; return whether this happened in time."""
        return await self.waiting.until(lambda: self.waits_for() is None, _PROVISION)

    def set_status(self, state: int, text: str = '') -> None:
        """
        Publish the node's state and a summary of refusals and errors.

        A failure to publish is only logged.

        :param text: reason for the state; empty: none.
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
        """Describe what the node is waiting for; None: nothing. To be overridden."""
        return None

    def on_ready(self) -> None:
        """Handle readiness, for example by publishing an initial state. To be overridden."""

    def serve(self, executor: Executor, stop: Callable[[], bool]) -> None:
        """Run callbacks until ``stop`` returns True. May be overridden to read input."""
        while not stop():
            self.turn(executor, 0.1)

    def turn(self, executor: Executor, seconds: float) -> None:
        """
        Wait for one callback and run it.

        Errors outside the guarded callbacks come from callbacks of futures and from messages that
        cannot be deserialised.
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
        """Run callbacks until ``busy`` returns False and the responses are sent."""
        deadline, executor = time.monotonic() + seconds, self.executor
        assert executor is not None, 'the node serves, or did'
        while busy() and time.monotonic() < deadline:
            self.turn(executor, _CHECK_PERIOD)
        for _ in range(_LAST_ROUNDS):
            self.turn(executor, 0.0)

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

    def _on_parameters(self, parameters: list[Parameter]) -> None:
        for parameter in parameters:
            if parameter.name in self._on_change:
                self._on_change[parameter.name](parameter.value)

    def _publish_remark(self) -> None:
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
        lacking = self.waits_for() or self._lacks_recorder()
        if lacking is not None:
            text = f'waits for {lacking}'
            if self.monotonic() - self._begun > _LATE and text != self._own_text:
                self.set_status(NodeStatus.STATE_STARTING, text)
                self.get_logger().warning(text)
            return
        self._start_timer.cancel()
        if self._expect_recorder:
            self.drain()  # the next status replaces the first one
        self.ready = True
        self.on_ready()
        self.set_status(NodeStatus.STATE_READY)

    def _lacks_recorder(self) -> str | None:
        """Describe a topic that the recorder lacks; None: no topic, or no recorder is expected."""
        if not self._expect_recorder:
            return None
        lacking = chain(
            (each.topic for each in self._stamped if not self.records(each)),
            (topic for topic in self._hidden if not self.is_recorded(topic)),
        )
        topic = next(lacking, None)
        return None if topic is None else f'the recorder to subscribe to {topic}'


def _failed(answer: Any, text: str) -> Any:
    """
    Return a response that reports an unexpected error.

    The status is STATUS_FAILED, or 0 if the type lacks it; 0 is not used otherwise.
    """
    result = getattr(answer, 'result', answer)
    if hasattr(result, 'status') and hasattr(result, 'detail'):
        result.status = getattr(result, 'STATUS_FAILED', 0)
        result.detail = f'an error that was not foreseen, see the log of the node: {text}'
    return answer


def end_goal(handle: ServerGoalHandle, good: bool, canceled: bool) -> None:
    """Set the final state of an action goal: succeeded, canceled by the client, or aborted."""
    if good:
        handle.succeed()
    elif canceled:
        handle.canceled()
    else:
        handle.abort()
