"""The node ``keyboard_teleop``: a person teaches, drives and watches from a terminal."""

from collections.abc import Callable
from functools import partial
import sys

from humanopts_ros.process import run_node
from humanopts_teach.dialogue.keys import SUSPEND
from humanopts_teach.language import _, N_, speaking
from humanopts_teach.ros.teleop import POLL_SECONDS, TeleopNode
from humanopts_teach.terminal.device import Device, why_not
from humanopts_teach.terminal.drawing import frame
from rclpy.executors import Executor

_FAREWELL = N_('Everything taught is saved; the same command continues it.')


class KeyboardTeleopNode(TeleopNode):
    """The node that owns the terminal."""

    def serve(self, executor: Executor, stop: Callable[[], bool]) -> None:
        """Serve the person until they quit, the terminal is closed, or the process must stop."""
        with speaking(self.app.language):
            farewell = '' if self.app.in_study else _(_FAREWELL)
        with Device(farewell) as device:
            while not (stop() or self.app.ended or device.closed):
                self.turn(executor, POLL_SECONDS)
                if not device.has_terminal():  # suspended: control is kept
                    self.process_pending()
                    continue
                keys = device.read()
                self.press([key for key in keys if key != SUSPEND])
                self.process_pending()
                if SUSPEND in keys:
                    device.suspend()
                elif self.frame_due() or device.resized():
                    device.draw(partial(frame, self.app))
                    self.drawn()
        self.send_last_requests()
        while not self.finished:
            self.turn(executor, POLL_SECONDS)


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    if fault := why_not():
        print(f'humanopts: no lesson at this terminal: {fault}', file=sys.stderr)
        return 2
    return run_node(KeyboardTeleopNode, args)


if __name__ == '__main__':
    sys.exit(main())
