"""A dialogue without a graph in this terminal, such as consent to a study."""

from functools import partial
import time

from humanopts_teach.dialogue.app import App
from humanopts_teach.dialogue.keys import SUSPEND
from humanopts_teach.terminal.device import Device
from humanopts_teach.terminal.drawing import frame

_POLL_SECONDS = 0.05


def converse(app: App) -> None:
    """Show a dialogue that makes no requests until it ends or the terminal is closed."""
    with Device() as device:
        seen: object = None
        while not (app.ended or device.closed):
            device.wait(_POLL_SECONDS)
            if not device.has_terminal():
                continue
            keys = device.read()
            app.type([key for key in keys if key != SUSPEND])
            app.advance(time.monotonic())
            if SUSPEND in keys:
                device.suspend()
            elif keys or app.shown != seen or device.resized():
                device.draw(partial(frame, app))
                app.drawn()
                seen = app.shown
