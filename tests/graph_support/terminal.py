"""A terminal emulator, and a person who reads and types: real keys through a pseudo-terminal."""

from collections.abc import Callable, Sequence
import fcntl
import os
import pty
import re
import select
import struct
import subprocess
import sys
import termios
import time
from typing import Any

import pyte

WIDTH, HEIGHT = 80, 24
LOOK = 0.02  # s between looks at the screen
SIDE = 24  # column where the panel beside the board begins
KEYS = {'down': '\x1b[B', 'up': '\x1b[A', 'right': '\x1b[C', 'left': '\x1b[D'}
ENTER, ESCAPE, CTRL_C = '\r', '\x1b', '\x03'


def run_to_judge(words: str) -> str:
    """Return the question about a run, or which run of the exam is next; empty: none."""
    asks = r'question \d+ about its|Exam: run \d+ of \d+\.|run \d+ of .* Was it right'
    found = re.search(asks, words)
    return found.group() if found else ''


def key_for(about: str) -> str:
    """Return the key that begins a run of the exam, or says that a run is right."""
    return 'y' if 'question' in about else 'r' if 'right' in about else 'enter'


class Terminal:
    """A terminal emulator with a process in it, and a person who reads and types."""

    def __init__(self, arguments: Sequence[str], domain_id: int, spin: Callable[[], None]) -> None:
        """
        Start Python in it.

        :param arguments: of Python.
        :param spin: lets the rest of the graph work while the person waits.
        """
        self._spin = spin
        self.master, self.slave = self._open = list(pty.openpty())
        fcntl.ioctl(self.slave, termios.TIOCSWINSZ, struct.pack('HHHH', HEIGHT, WIDTH, 0, 0))
        self.before = termios.tcgetattr(self.slave)
        self.screen = pyte.Screen(WIDTH, HEIGHT)
        self.stream = pyte.ByteStream(self.screen)
        self.raw = b''
        self._lines: list[str] = []  # on the screen; empty: it has changed
        self.process = subprocess.Popen(
            ['setsid', '--ctty', sys.executable, *arguments],
            stdin=self.slave,
            stdout=self.slave,
            stderr=subprocess.PIPE,
            env={**os.environ, 'ROS_DOMAIN_ID': str(domain_id)},
        )

    def lines(self) -> list[str]:
        """Return the lines of the screen; to render them takes longer than a callback."""
        self._lines = self._lines or self.screen.display
        return self._lines

    def text(self) -> str:
        """Return what is on the screen, line by line."""
        return '\n'.join(self.lines())

    def words(self) -> str:
        """Return what is beside the board, with wrapped lines joined."""
        return ' '.join(' '.join(line[SIDE:] for line in self.lines()).split())

    def read(self, seconds: float = 0.05) -> None:
        """Take in what the process has written."""
        if select.select([self.master], [], [], seconds)[0]:
            data = os.read(self.master, 65536)
            self.raw += data
            self.stream.feed(data)
            self._lines = []

    def until(self, condition: Callable[[], Any], what: str, seconds: float = 30.0) -> None:
        """
        Read, and let the other nodes work, until a condition holds.

        :param seconds: at most, without time that the machine gives to other processes.
        """
        waited = 0.0
        while not condition():
            assert waited < seconds, f'timed out waiting for {what}:\n{self.text()}'
            looked = time.monotonic()
            while time.monotonic() < looked + LOOK:
                self._spin()
                self.read(0.0)
            waited += min(time.monotonic() - looked, 2 * LOOK)

    def see(self, text: str, seconds: float = 30.0) -> None:
        """Read until a text is on the screen, however it is wrapped."""
        self.until(lambda: text in self.words() or text in self.text(), repr(text), seconds)

    def press(self, *keys: str) -> None:
        """Press keys."""
        os.write(self.master, ''.join(KEYS.get(key, key) for key in keys).encode())

    def ended(self) -> int:
        """Wait for the process's end and return its status."""
        self.until(lambda: self.process.poll() is not None, 'the end', 15.0)
        self.read()
        return self.process.returncode

    def restored(self) -> bool:
        """Tell whether the settings are what they were, and screen and cursor are given back."""
        left = self.raw.rfind(b'\x1b[?1049l') > self.raw.rfind(b'\x1b[?1049h')
        cursor = self.raw.rfind(b'\x1b[?25h') > self.raw.rfind(b'\x1b[?25l')
        return left and cursor and termios.tcgetattr(self.slave) == self.before

    def errors(self) -> str:
        """Return what the process that has ended wrote on standard error."""
        return self.process.communicate()[1].decode(errors='replace')

    def close(self) -> None:
        """End whatever is left."""
        if self.process.poll() is None:
            self.process.kill()
        self.process.communicate()
        self.hang_up()

    def hang_up(self) -> None:
        """Cut the connection."""
        while self._open:
            os.close(self._open.pop())
