"""One launch at a time for each ROS domain id and namespace of this machine."""

from collections.abc import Iterator
from contextlib import contextmanager
import fcntl
import hashlib
import os
from pathlib import Path
import tempfile

from humanopts_teach.launching import LaunchError


@contextmanager
def only_launch(namespace: str) -> Iterator[None]:
    """
    Hold the place of the one launch in this ROS_DOMAIN_ID and namespace.

    :raises LaunchError: another one holds it; the text names its process.
    """
    domain = int(os.environ.get('ROS_DOMAIN_ID') or 0)
    key = hashlib.sha256(f'{domain} {namespace}'.encode()).hexdigest()[:12]
    path = Path(tempfile.gettempdir()) / f'humanopts-{os.getuid()}-{key}.lock'
    with path.open('a+', encoding='utf-8') as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.seek(0)
            raise LaunchError(
                f'process {file.read().strip() or "?"} runs humanopts already in ROS_DOMAIN_ID '
                f'{domain}, namespace {namespace}; stop it, or choose another --namespace or '
                'ROS_DOMAIN_ID'
            ) from None
        file.truncate(0)
        file.write(str(os.getpid()))
        file.flush()
        yield
