"""A node with guarded callbacks and checked parameters; startup of ROS."""

from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
import functools
import inspect
import time
from typing import Any, TypeVar

from humanopts_ros.guard import Guard
from humanopts_ros.middleware import MiddlewareError
from humanopts_ros.publisher import without_source
from humanopts_ros.qos import STREAM
from humanopts_ros.senders import sender_of, signer
from humanopts_ros.waiting import drive
from humanopts_ros.workarounds import prepare_discovery
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
import rclpy
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.context import Context
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.service import Service
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from rclpy.timer import Timer

SEEDS = (0, 2**62)
PATIENCE = (0.1, 3600.0)  # s, allowed range of deadlines
STEADY = Clock(clock_type=ClockType.STEADY_TIME)

T = TypeVar('T')
V = TypeVar('V')
D = TypeVar('D', bound=Any)  # a dataclass
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


def start_ros(
    args: list[str] | None = None,
    context: Context | None = None,
    signals: SignalHandlerOptions = SignalHandlerOptions.NO,
) -> None:
    """
    Start ROS with the environment's settings.

    :param args: command-line arguments.
    :param context: rclpy context; None: the default context.
    :param signals: signals that shut ROS down; by default none, so the caller handles them.
    :raises MiddlewareError: ROS cannot start.
    """
    prepare_discovery()
    with starting_ros():
        rclpy.init(args=args, context=context, signal_handler_options=signals)


class GuardedNode(Node):
    """
    A node that continues after errors in its callbacks.

    Invalid messages are dropped and unexpected errors logged; the guard counts both. After an
    error, services respond with a status and a text.

    :ivar destroyed: whether the node has been destroyed.
    """

    def __init__(
        self, name: str, *, monotonic: Callable[[], float] = time.monotonic, **options: Any
    ) -> None:
        """
        Create the node; parameters as in ``NodeBase``.

        :raises MiddlewareError: the middleware cannot join the graph.
        """
        ends = StartError, ExternalShutdownException
        self.guard = Guard(self.get_logger, monotonic, self._on_remark, ends)
        with starting_ros():
            super().__init__(name, **options)
        self.monotonic = monotonic
        self.destroyed = False
        self._on_change: dict[str, Callable[[Any], object]] = {}  # by parameter name
        self.add_post_set_parameters_callback(self.guard.guarded(self._on_parameters))

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
        guarded, options['clock'] = self.guard.guarded(callback), STEADY
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

        If ``senders`` allows only one publisher on the topic, refuse messages from other nodes.
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
        """Create a service that always responds, with a guarded callback or coroutine."""

        def failed(text: str, request: Any, response: Any) -> Any:
            return failed_response(srv_type.Response(), text)

        guarded = self.guard.guarded(callback, failed)
        if not inspect.iscoroutinefunction(callback):
            return super().create_service(srv_type, srv_name, guarded, **options)
        service = super().create_service(srv_type, srv_name, lambda *r: guarded(*r), **options)
        send = self.guard.guarded(service.send_response)

        def respond(coroutine: Any, header: Any) -> None:
            drive(coroutine, lambda response: send(response, header))

        service.send_response = respond  # type: ignore[method-assign, assignment]
        return service

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

    def accepted(self, topic: str, read: Callable[[T], V | None], message: T) -> V | None:
        """Return the value of a message, or None if it is refused or ignored."""
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

        :param between: allowed range of a number; None: any.
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
            raise StartError(f'parameter {name}: {value!r} is not one of {", ".join(among)}')
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
        :param between: allowed ranges by field; other fields accept any value.
        :raises StartError: as in ``setting``.
        """
        values = {
            name: self.setting(name, getattr(defaults, name), text, between.get(name))
            for name, text in descriptions.items()
        }
        return replace(defaults, **values)

    def _on_parameters(self, parameters: list[Parameter]) -> None:
        for parameter in parameters:
            if parameter.name in self._on_change:
                self._on_change[parameter.name](parameter.value)

    def _on_remark(self) -> None:
        """Handle a new refusal or error. To be overridden."""


def failed_response(answer: Any, text: str) -> Any:
    """
    Return a response that reports an unexpected error.

    The status is STATUS_FAILED, or 0 if the type lacks it; 0 is not used otherwise.
    """
    result = getattr(answer, 'result', answer)
    if hasattr(result, 'status') and hasattr(result, 'detail'):
        result.status = getattr(result, 'STATUS_FAILED', 0)
        result.detail = f'unexpected error; see the log of the node: {text}'
    return answer
