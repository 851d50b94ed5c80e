"""
Which session is open, on disk: a lesson whose process has died goes on with it.

Only a process with the same parent takes it up, which is a launcher that starts a node again:
the next launch begins with a session of its own.
"""

from contextlib import suppress
import json
import os
from pathlib import Path

from humanopts_ros.limits import JsonError, parse_json
import psutil

FILE = 'open_session.json'


class OpenPlace:
    """The file in the folder of demonstrations that names the open session."""

    def __init__(self, folder: Path) -> None:
        """Name the file; nothing is written."""
        self._path = folder / FILE
        parent = psutil.Process(os.getppid())
        self._parent = f'{parent.pid} {parent.create_time()}'

    def left(self) -> tuple[str, str] | None:
        """Return participant and session that a process before this one has left open."""
        try:
            values = parse_json(self._path.read_text('utf-8'))
            if values['parent'] == self._parent:
                return str(values['participant']), str(values['session'])
        except (OSError, JsonError, UnicodeError, LookupError, TypeError):
            pass  # there is none, or it is not ours
        return None

    def keep(self, participant: str, session: str) -> None:
        """Note what is open; where that fails, a lesson that is started again has no session."""
        values = {'parent': self._parent, 'participant': participant, 'session': session}
        new = self._path.with_name(f'{FILE}.new')
        with suppress(OSError):
            new.write_text(json.dumps(values), 'utf-8')
            os.replace(new, self._path)

    def forget(self) -> None:
        """Note that nothing is open."""
        with suppress(OSError):
            self._path.unlink()
