"""
Two hosts on one machine: network namespaces of their own, joined by a cable that can be pulled.

Each has its own interfaces, addresses, shared memory and folder for locks, so that nothing but the
cable joins them. It needs root, or a kernel that lets everybody make user namespaces.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
import os
from pathlib import Path
import signal
import subprocess
import sys

from humanopts_ros.middleware import PROFILES

ADDRESSES = '10.77.0.1', '10.77.0.2'
CABLE = 'cable'
_WAIT = 'ip link set lo up && mount -t tmpfs tmpfs /dev/shm && echo ready && exec sleep infinity'
_ENDING = 30.0  # s


def enter_network(pid: int, *more: str) -> list[str]:
    """Return what goes before a command that runs on the host of a process."""
    return [
        'nsenter',
        f'--target={pid}',
        *more,
        '--net',
        '--mount',
        '--preserve-credentials',
        '--',
    ]


class Host:
    """One of the hosts."""

    def __init__(self, pid: int, address: str, peer: str, folder: Path) -> None:
        self.pid, self.address, self.peer, self.folder = pid, address, peer, folder
        self._enter = enter_network(pid, '--user')
        folder.mkdir()

    def run(self, *command: str) -> None:
        """Run a command to its end."""
        subprocess.run([*self._enter, *command], check=True, capture_output=True)

    def start(
        self, arguments: Sequence[str], log: Path, **variables: str
    ) -> 'subprocess.Popen[bytes]':
        """Start Python with arguments; what it says goes to a file."""
        ours = {name: value for name, value in os.environ.items() if name not in PROFILES}
        environment = {**ours, 'TMPDIR': str(self.folder), 'ROS_DOMAIN_ID': '0', **variables}
        with log.open('wb') as said:
            return subprocess.Popen(
                [*self._enter, sys.executable, *arguments],
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=said,
                stderr=said,
            )


@contextmanager
def two_hosts(folder: Path) -> Iterator[tuple[Host, Host]]:
    """
    Make two hosts that are joined by a cable.

    :raises OSError: this machine does not let us; the text says what is missing.
    """
    holders: list[subprocess.Popen[bytes]] = []
    try:
        holders.append(_holder(['unshare', '--user', '--map-root-user']))
        inside = [
            'nsenter',
            f'--target={holders[0].pid}',
            '--user',
            '--preserve-credentials',
            '--',
        ]
        holders.append(_holder([*inside, 'unshare']))
        hosts = [
            Host(holder.pid, own, other, folder / name)
            for holder, own, other, name in zip(
                holders, ADDRESSES, reversed(ADDRESSES), ('a', 'b'), strict=True
            )
        ]
        peer = ['peer', 'name', CABLE, 'netns', str(holders[1].pid)]
        hosts[0].run('ip', 'link', 'add', CABLE, 'type', 'veth', *peer)
        for host in hosts:
            host.run('ip', 'address', 'add', f'{host.address}/24', 'dev', CABLE)
            host.run('ip', 'link', 'set', CABLE, 'up', 'multicast', 'on')
        yield hosts[0], hosts[1]
    except (OSError, subprocess.CalledProcessError) as error:
        detail = getattr(error, 'stderr', None)
        said = detail.decode().strip() if detail else str(error)
        raise OSError(
            f'two hosts need unshare, nsenter and ip, and their rights: {said}'
        ) from error
    finally:
        for holder in holders:
            holder.kill()
            holder.wait()


@contextmanager
def pulled(host: Host) -> Iterator[None]:
    """Pull the cable meanwhile."""
    host.run('ip', 'link', 'set', CABLE, 'down')
    try:
        yield
    finally:
        host.run('ip', 'link', 'set', CABLE, 'up')


def end(process: 'subprocess.Popen[bytes]') -> int:
    """Ask a process to end, as Ctrl-C does, and return its exit status."""
    process.send_signal(signal.SIGINT)
    return process.wait(_ENDING)


def _holder(before: Sequence[str]) -> 'subprocess.Popen[bytes]':
    """Start a process that keeps namespaces of a network and of mounts."""
    process = subprocess.Popen(
        [*before, '--net', '--mount', 'sh', '-c', _WAIT],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    assert process.stdout is not None
    assert process.stderr is not None
    if process.stdout.readline() != b'ready\n':
        said = process.stderr.read().decode().strip()
        process.wait()
        raise OSError(said)
    return process
