"""A bar of progress for commands that need no ROS."""

from collections.abc import Iterator
from contextlib import contextmanager
import time
from typing import Protocol

from rich.console import Console
from rich.progress import Progress

_PERIOD = 0.1  # seconds between two drawings of the same work


class Tell(Protocol):
    """Shows how far work is."""

    def __call__(self, done: int, total: int, text: str = 'reading') -> None:
        """Show how much is done, of how much, and what is under way."""
        ...


@contextmanager
def progress_bar() -> Iterator[Tell]:
    """Show a bar on standard error where it is a terminal."""
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task('reading', total=None)
        shown, due = '', 0.0

        def tell(done: int, total: int, text: str = 'reading') -> None:
            nonlocal shown, due
            if text != shown or time.monotonic() >= due:
                shown, due = text, time.monotonic() + _PERIOD
                progress.update(task, completed=done, total=total, description=text)

        yield tell
