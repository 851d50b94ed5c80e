"""A dialogue in this terminal that needs no graph."""

from functools import partial
import time

from humanopts_teach.dialogue.app import App
from humanopts_teach.dialogue.keys import SUSPEND
from humanopts_teach.launching.job import shell_job_ended
from humanopts_teach.terminal.device import Device
from humanopts_teach.terminal.drawing import frame

_POLL_SECONDS = 0.05  # maximum delay of a key


def show(app: App) -> None:
    """Show a dialogue until it has ended or the terminal is closed."""
    with Device() as device:
        drawn: object = None
        while not (app.ended or device.closed or shell_job_ended()):
            if not device.has_terminal():  # suspended
                time.sleep(_POLL_SECONDS)
                continue
            device.wait(_POLL_SECONDS)
            keys = device.read()
            app.type(key for key in keys if key != SUSPEND)
            app.advance(time.monotonic())
            if SUSPEND in keys:
                device.suspend()
            elif app.shown != drawn or keys or device.resized():
                device.draw(partial(frame, app))
                app.drawn()
                drawn = app.shown
