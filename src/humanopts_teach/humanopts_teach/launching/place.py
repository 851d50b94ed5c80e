"""
Which nodes run where: the first launch of a node in a ROS_DOMAIN_ID and namespace has its place.

A place is the name of a Unix socket in the abstract namespace of Linux. All users of a machine
share it, whatever their folders; binding is atomic, nothing is on disk, and the kernel frees the
name with the process.
"""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager, ExitStack, suppress
import errno
import hashlib
import os
import pwd
import socket
import struct

from humanopts_teach.launching import OccupiedError

_CREDENTIALS = struct.Struct('3i')  # of SO_PEERCRED: process, user, group
_held: dict[bytes, socket.socket] = {}  # by this process


def domain_id() -> int:
    """Return the ROS_DOMAIN_ID."""
    return int(os.environ.get('ROS_DOMAIN_ID') or 0)


def _address(namespace: str, node: str) -> bytes:
    key = hashlib.sha256(f'{domain_id()} {namespace} {node}'.encode()).hexdigest()
    return f'\0humanopts-{key}'.encode()


def holder(namespace: str, node: str) -> tuple[int, str] | None:
    """
    Return who has launched a node in a namespace, on this machine.

    :return: the process, 0 where it is in another container, and its user; None: nobody.
    """
    with socket.socket(socket.AF_UNIX) as probe:
        probe.setblocking(False)
        try:
            probe.connect(_address(namespace, node))
            found = probe.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
        except ConnectionRefusedError:
            return None
        except OSError:  # its launcher is stopped, and others have asked before
            return 0, ''
    process, user, _ = _CREDENTIALS.unpack(found)
    with suppress(KeyError):
        return process, pwd.getpwuid(user).pw_name
    return process, str(user)


@contextmanager
def only_launch(namespace: str, nodes: Iterable[str]) -> Iterator[None]:
    """
    Hold the places of nodes; those that this process holds already stay its own.

    :param nodes: names without the namespace.
    :raises OccupiedError: others hold some of them; the text names the nodes and the processes.
    """
    taken: dict[tuple[int, str], list[str]] = {}  # nodes, by process and user
    with ExitStack() as stack:
        for node in sorted(nodes):  # of two that come at once, one gets the first that both want
            address = _address(namespace, node)
            if address in _held:
                continue
            own = stack.enter_context(socket.socket(socket.AF_UNIX))
            own.setblocking(False)
            try:
                own.bind(address)
            except OSError as error:
                if error.errno != errno.EADDRINUSE:
                    raise
                taken.setdefault(holder(namespace, node) or (0, ''), []).append(node)
                continue
            own.listen(socket.SOMAXCONN)
            _held[address] = own
            stack.callback(_held.pop, address)
        if taken:
            raise OccupiedError(_said(taken, namespace))
        yield


def answer() -> None:
    """Let those go who have asked who holds a place; to be called often."""
    for own in _held.values():
        with suppress(OSError):
            while True:
                own.accept()[0].close()


def _said(taken: dict[tuple[int, str], list[str]], namespace: str) -> str:
    who = '; '.join(
        f'{f"process {process}" if process else "a process"}{f" of {user}" if user else ""} '
        f'runs humanopts already in ROS_DOMAIN_ID {domain_id()}, namespace {namespace}: '
        f'{", ".join(nodes)}'
        for (process, user), nodes in taken.items()
    )
    return f'{who}; stop it, or choose another --namespace or ROS_DOMAIN_ID'
