"""A ROS domain and a folder for the processes of a benchmark alone."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
import os
from pathlib import Path
import socket
import tempfile

from humanopts_teach.launching import LaunchError

# Domains whose UDP ports lie above those that Linux hands out to other programs.
DOMAIN_IDS = range(215, 232)
_FIRST_PORT, _PORTS, _DISCOVERY = 7400, 250, 10  # DDSI-RTPS 2.2, section 9.6.1.1


@contextmanager
def own_place() -> Iterator[Path]:
    """
    Have a folder for files that nobody needs afterwards, and a ROS_DOMAIN_ID for new processes.

    :raises LaunchError: every domain is in use.
    """
    with tempfile.TemporaryDirectory(prefix='humanopts-bench-') as folder, own_domain():
        yield Path(folder)


@contextmanager
def own_domain() -> Iterator[int]:
    """
    Have new processes use a ROS_DOMAIN_ID that no process of this machine uses.

    Messages are not checked field by field meanwhile, as they are only where programs are tested.

    :raises LaunchError: every domain is in use.
    """
    order = [DOMAIN_IDS[(os.getpid() + n) % len(DOMAIN_IDS)] for n in range(len(DOMAIN_IDS))]
    number = next((number for number in order if _is_free(number)), None)
    if number is None:
        raise LaunchError(
            f'every ROS_DOMAIN_ID from {DOMAIN_IDS[0]} to {DOMAIN_IDS[-1]} is in use; end what '
            'uses one of them'
        )
    with _environment({'ROS_DOMAIN_ID': str(number), 'ROS_PYTHON_CHECK_FIELDS': '0'}):
        yield number


def _is_free(domain_id: int) -> bool:
    """Tell whether the port that the first participant of a domain takes is free."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(('', _FIRST_PORT + _PORTS * domain_id + _DISCOVERY))
        except OSError:
            return False
    return True


@contextmanager
def _environment(values: Mapping[str, str]) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
