"""The ``keyboard_teleop`` nodes of all browser participants, in one thread of the server."""

from collections.abc import Callable, Mapping
import threading
import traceback
from typing import Any

from humanopts_interfaces.msg import NodeStatus
from humanopts_ros.guarded_node import start_ros
from humanopts_ros.node_base import NodeBase
from humanopts_teach.dialogue.panel import ScreenView
from humanopts_teach.dialogue.view import view
from humanopts_teach.ros.teleop import POLL_SECONDS, TeleopNode
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.utilities import try_shutdown

_IDLE_SECONDS = 0.1  # polling period while idle
_LEAVE_HINT = 'this page can be closed'
Show = Callable[[ScreenView, int], object]


class BrowserTeleopNode(TeleopNode):
    """Provides the dialogue of one participant as frames for the page."""

    def __init__(
        self,
        namespace: str,
        parameters: Mapping[str, Any],
        show: Show,
        ended: Callable[[], object],
    ) -> None:
        """
        Join the graph of a participant.

        :param show: callback for each frame and its number, invoked in the node thread.
        :param ended: callback invoked once, when the person quits or an error ends the dialogue.
        """
        given = [Parameter(name, value=value) for name, value in parameters.items()]
        super().__init__(namespace=namespace, parameter_overrides=given)
        self.app.leave_hint = _LEAVE_HINT
        self._show_frame, self._on_end = show, ended
        self._end_reported = False

    def turn_once(self) -> None:
        """Process pending work; an error ends only this dialogue."""
        try:
            self.process_pending()
            if self.frame_due():
                self._show_frame(view(self.app), self.drawn())
        except Exception:
            self.get_logger().error(traceback.format_exc())
            self.app.ended = True
        if self.app.ended and not self._end_reported:
            self._end_reported = True
            self._on_end()


class TeleopThread:
    """Runs the nodes of all participants in one ROS context."""

    def __init__(self) -> None:
        start_ros(['--ros-args', '--disable-stdout-logs'])
        self._executor = SingleThreadedExecutor()
        self._nodes: dict[BrowserTeleopNode, Callable[[], object] | None] = {}  # close callbacks
        self._ending = False
        self._thread = threading.Thread(target=self._run, name='nodes')
        self._thread.start()

    def call(self, work: Callable[[], object]) -> None:
        """Run a callback in the node thread; thread-safe."""
        self._executor.create_task(work)

    def open(self, made: Callable[[], BrowserTeleopNode], then: Callable[[Any], object]) -> None:
        """
        Create a node in the node thread.

        :param then: callback invoked there with the node, or with the error that prevented it.
        """

        def make() -> None:
            try:
                node = made()
            except Exception as error:
                then(error)
                return
            self._executor.add_node(node)
            self._nodes[node] = None
            then(node)

        self.call(make)

    def close(self, node: BrowserTeleopNode, then: Callable[[], object]) -> None:
        """Let a node send its last requests and leave the graph, then call ``then``."""

        def part() -> None:
            node.send_last_requests()
            self._nodes[node] = then

        self.call(part)

    def stop(self) -> None:
        """Stop the thread and shut down the ROS context."""
        self._ending = True
        self._executor.wake()  # its wait may be long if the system time was set back
        self._thread.join()
        for node in self._nodes:
            node.destroy_node()
        self._executor.shutdown()
        try_shutdown()

    def _run(self) -> None:
        while not self._ending:
            busy = any(node.busy or node.last_answers is not None for node in self._nodes)
            self._spin(POLL_SECONDS if busy else _IDLE_SECONDS)
            for node, then in list(self._nodes.items()):
                if node.last_answers is None:
                    node.turn_once()
                elif node.finished:
                    self._leave(node)
                    if then is not None:
                        then()

    def _spin(self, seconds: float) -> None:
        if not self._nodes:
            self._executor.spin_once(seconds)
            return
        first: NodeBase = next(iter(self._nodes))
        first.turn(self._executor, seconds)

    def _leave(self, node: BrowserTeleopNode) -> None:
        node.set_status(NodeStatus.STATE_STOPPING)
        node.drain()
        self._executor.remove_node(node)
        node.destroy_node()
        del self._nodes[node]
