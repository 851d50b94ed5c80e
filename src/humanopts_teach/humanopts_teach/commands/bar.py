"""A bar of progress for commands that need no ROS."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import Progress

Tell = Callable[[int, int, str], None]  # done, of how many, what is under way


@contextmanager
def progress_bar() -> Iterator[Tell]:
    """Show a bar on standard error where it is a terminal."""
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task('reading', total=None)
        yield lambda done, total, text: progress.update(
            task, completed=done, total=total, description=text
        )
