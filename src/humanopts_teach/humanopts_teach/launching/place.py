"""
Reservation of nodes for one launch, in a ROS_DOMAIN_ID and namespace, and in a folder.

A reservation is the name of a Unix socket in the abstract namespace of Linux. All users of a
machine share it; binding is atomic, nothing is on disk, and the kernel frees the name when the
process ends.
"""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager, ExitStack, suppress
import errno
import hashlib
import os
from pathlib import Path
import pwd
import socket
import struct

from humanopts_teach.launching import OccupiedError

_CREDENTIALS = struct.Struct('3i')  # of SO_PEERCRED: process, user, group
_held: dict[bytes, socket.socket] = {}  # reserved by this process


def domain_id() -> int:
    """Return the ROS_DOMAIN_ID."""
    return int(os.environ.get('ROS_DOMAIN_ID') or 0)


def _graph(namespace: str) -> str:
    return f'ROS_DOMAIN_ID {domain_id()}, namespace {namespace}'


def _address(where: str, node: str) -> bytes:
    return f'\0humanopts-{hashlib.sha256(f"{where} {node}".encode()).hexdigest()}'.encode()


def holder(namespace: str, node: str) -> tuple[int, str] | None:
    """
    Return the process that has launched a node in a namespace on this machine.

    :return: process id and user; 0: unknown, for example in another container. None: no process.
    """
    return _holder(_address(_graph(namespace), node))


def _holder(address: bytes) -> tuple[int, str] | None:
    with socket.socket(socket.AF_UNIX) as probe:
        probe.setblocking(False)
        try:
            probe.connect(address)
            found = probe.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
        except ConnectionRefusedError:
            return None
        except OSError:  # its launcher is stopped, and earlier requests fill its queue
            return 0, ''
    process, user, _ = _CREDENTIALS.unpack(found)
    with suppress(KeyError):
        return process, pwd.getpwuid(user).pw_name
    return process, str(user)


@contextmanager
def only_launch(
    namespace: str, nodes: Iterable[str], folder: Path | None = None
) -> Iterator[None]:
    """
    Reserve nodes in a namespace and in a folder; this process may reserve them repeatedly.

    :param nodes: node names without the namespace.
    :param folder: folder that they write to; None: any.
    :raises OccupiedError: other processes have reserved some nodes; the text names both.
    """
    with ExitStack() as stack:
        _reserve(_graph(namespace), nodes, '--namespace or ROS_DOMAIN_ID', stack)
        if folder is not None:
            _reserve(os.path.realpath(folder), nodes, '--out', stack)
        yield


def _reserve(where: str, nodes: Iterable[str], option: str, stack: ExitStack) -> None:
    taken: dict[tuple[int, str], list[str]] = {}  # nodes, by process and user
    for node in sorted(nodes):  # same order for all launches: one gets the first common node
        address = _address(where, node)
        if address in _held:
            continue
        own = stack.enter_context(socket.socket(socket.AF_UNIX))
        own.setblocking(False)
        try:
            own.bind(address)
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise
            taken.setdefault(_holder(address) or (0, ''), []).append(node)
            continue
        own.listen(socket.SOMAXCONN)
        _held[address] = own
        stack.callback(_held.pop, address)
    if taken:
        who = '; '.join(
            f'{f"process {process}" if process else "a process"}{f" of {user}" if user else ""} '
            f'already runs {", ".join(held)}'
            for (process, user), held in taken.items()
        )
        raise OccupiedError(f'{who} in {where}; stop it, or choose another {option}')


def answer() -> None:
    """Accept and close connections of processes that query the holder; call this often."""
    for own in _held.values():
        with suppress(OSError):
            while True:
                own.accept()[0].close()
