"""The terminal device: reads raw keys, draws lines, and restores the terminal on exit."""

from collections.abc import Callable, Mapping, Sequence
import curses
import os
import select
import signal
import sys
import time
from typing import Any, cast

from humanopts_teach.dialogue import keys
from humanopts_teach.launching.job import in_foreground
from humanopts_teach.terminal.drawing import Colours
from prompt_toolkit.input.vt100 import Vt100Input
from prompt_toolkit.key_binding.key_processor import KeyPress
from prompt_toolkit.keys import Keys
from rich.console import Console

ESCAPE_SECONDS = 0.1  # timeout after which an escape character counts as the Escape key
_TAKEN_SECONDS = 1.0  # maximum time for a shell to reclaim the terminal of a suspended job
_SETTLED_SECONDS = 0.1  # time for a shell to set up the terminal of a resumed job
_ENTER = '\x1b[?1049h\x1b[?25l\x1b[2J'  # alternate screen, hidden cursor, cleared
_LEAVE = '\x1b[0m\x1b[?25h\x1b[?1049l'
_NAMED: Mapping[str, str] = {
    Keys.Up: keys.UP,
    Keys.Down: keys.DOWN,
    Keys.Left: keys.LEFT,
    Keys.Right: keys.RIGHT,
    Keys.ControlM: keys.ENTER,
    Keys.ControlJ: keys.ENTER,
    Keys.Escape: keys.ESCAPE,
    Keys.ControlH: keys.BACKSPACE,
    Keys.ControlC: keys.INTERRUPT,
    Keys.ControlD: keys.END_OF_FILE,
    Keys.ControlU: keys.CLEAR,
    Keys.ControlZ: keys.SUSPEND,
}
_USUAL_TERM = 'for most terminals: export TERM=xterm-256color'
_HUNG_UP = select.POLLHUP | select.POLLERR | select.POLLNVAL


def why_not() -> str:
    """Return why standard input and output are unusable; empty: they are usable."""
    if not sys.stdin.isatty() or not sys.stdout.isatty():
        return 'it needs a terminal for input and output'
    if not (name := os.environ.get('TERM', '')):
        return f'it needs to know your terminal, and TERM is not set; {_USUAL_TERM}'
    try:
        curses.setupterm(name, 1)
    except curses.error:
        return f'TERM is {name!r}, which this machine does not know; {_USUAL_TERM}'
    if name == 'dumb' or curses.tigetstr('cup') is None:
        return f'it needs a terminal that can move its cursor, and TERM is {name!r}; {_USUAL_TERM}'
    return ''


def key_of(press: KeyPress) -> str:
    """Return the humanopts name of a key press; empty: the key is not used."""
    if press.key in _NAMED:
        return _NAMED[press.key]
    key = str(press.key)
    return key if len(key) == 1 and key.isprintable() else ''


def usable_colours(console: Console) -> Colours | None:
    """Return the terminal's colour system; None: no colours, or NO_COLOR is set."""
    system = None if console.no_color else console.color_system
    return cast(Colours | None, system)


class Device:
    """
    Context manager for standard input in raw mode and the alternate screen.

    A background job leaves the terminal to the shell: nothing is read or drawn until
    ``has_terminal`` returns True.
    """

    def __init__(self, farewell: str = '') -> None:
        """
        Inspect the terminal.

        :param farewell: line to print after a clean exit.
        """
        self._farewell = farewell
        self._input = Vt100Input(sys.stdin)
        self._raw = self._input.raw_mode()
        self._held = False  # in raw mode, on the alternate screen
        self._asked_at = 0.0  # s, time of the suspension
        self._taken = False  # the shell has reclaimed the terminal since then
        self._since: float | None = None  # s, start of foreground time; None: in the background
        self._poll = select.poll()
        self._poll.register(self._input.fileno(), select.POLLIN)
        self._drawn: list[str] = []
        self._size = (0, 0)
        self._read_at = 0.0
        self.closed = False  # the terminal is gone
        self._colours = usable_colours(Console())

    def __enter__(self) -> 'Device':
        self._asked_at = time.monotonic()
        if in_foreground(self._input.fileno()):
            self._take()
        return self

    def __exit__(self, *error: Any) -> None:
        self._give_back()
        if error == (None, None, None) and self._farewell:
            self._write(f'{self._farewell}\n')

    def suspend(self) -> None:
        """Restore the terminal and suspend the job, as Ctrl-Z usually does."""
        self._give_back()
        self._asked_at, self._taken, self._since = time.monotonic(), False, None
        os.killpg(os.getpgrp(), signal.SIGTSTP)

    def has_terminal(self) -> bool:
        """Return whether to read and draw: False while the job is in the background."""
        if self._held or self.closed:
            return True
        now = time.monotonic()
        if not in_foreground(self._input.fileno()):
            self._taken, self._since = True, None
            return False
        self._since = self._since if self._since is not None else now
        settled = now - self._since > (_SETTLED_SECONDS if self._taken else _TAKEN_SECONDS)
        if settled or now - self._asked_at > 2 * _TAKEN_SECONDS:
            self._take()
        return self._held

    def _take(self) -> None:
        self._raw = self._input.raw_mode()
        self._raw.__enter__()
        self._write(_ENTER)
        self._held, self._drawn, self._size = True, [], (0, 0)

    def _give_back(self) -> None:
        if self._held:
            self._write(_LEAVE)
            self._raw.__exit__(None, None, None)
            self._held = False

    def read(self) -> list[str]:
        """Return the keys pressed since the last call, without blocking."""
        events = [event for _, event in self._poll.poll(0)]
        presses = self._input.read_keys() if any(e & select.POLLIN for e in events) else []
        self.closed |= self._input.closed
        self.closed |= not presses and any(e & _HUNG_UP for e in events)
        now = time.monotonic()
        if events:
            self._read_at = now
        elif now - self._read_at > ESCAPE_SECONDS:
            presses += self._input.flush_keys()
        return [key for key in map(key_of, presses) if key]

    def wait(self, seconds: float) -> None:
        """Wait for a key, with a timeout."""
        self._poll.poll(1e3 * seconds)

    def resized(self) -> bool:
        """Return whether the window has been resized since the last frame."""
        return self._window() != self._size

    def draw(self, frame: Callable[[int, int, Colours | None], Sequence[str]]) -> None:
        """Draw a frame, writing only the lines that changed."""
        size = self._window()
        lines = list(frame(*size, self._colours))
        old = self._drawn if size == self._size else []
        output = '' if old else '\x1b[2J'
        for row, line in enumerate(lines):
            if row >= len(old) or line != old[row]:
                output += f'\x1b[{row + 1};1H\x1b[0m{line}\x1b[0m\x1b[K'
        self._drawn, self._size = lines, size
        self._write(output)

    def _window(self) -> tuple[int, int]:
        try:
            size = os.get_terminal_size(sys.stdout.fileno())
        except OSError:
            return (80, 24)
        return (size.columns or 80, size.lines or 24)  # some terminals report 0 x 0

    def _write(self, text: str) -> None:
        data = text.encode('utf-8', 'replace')
        try:
            while data:
                data = data[os.write(sys.stdout.fileno(), data) :]
        except BlockingIOError:
            select.select([], [sys.stdout.fileno()], [], 1.0)
            self._drawn = []
        except OSError:
            self.closed = True
