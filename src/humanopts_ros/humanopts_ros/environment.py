"""Environment variables that humanopts processes share, and how they find each other."""

from importlib.resources import files
import os
from pathlib import Path
import socket
import sys
import time

from humanopts_ros.middleware import (
    address_towards,
    check_settings,
    PROFILES,
    RANGE,
    static_peers,
    stays_here,
)
import psutil

LAUNCHER_PID = 'HUMANOPTS_LAUNCHER_PID'  # of the process that started a node; it ends with it
INSTANCE = 'HUMANOPTS_INSTANCE'  # how the publisher_id of a node ends that a launcher started
READ_PROFILES = 'RMW_FASTRTPS_USE_QOS_FROM_XML'  # '1': what a profile says of memory, too
_READERS = 'jazzy', 'rmw_fastrtps_cpp'  # distribution and middleware that read both profiles
_USUAL_PROFILES = Path('DEFAULT_FASTRTPS_PROFILES.xml')  # of the working folder: read, too
_NETWORK_WAIT = 10.0  # s
_LOOK_PERIOD = 0.05  # s


def prepare_discovery() -> None:
    """
    Make Fast DDS announce this process often and give memory back, unless the user has profiles.

    Where the graph spans machines this waits for their network: a process announces the addresses
    that it has when it joins the graph, and never others.

    Where the graph is to stay on this machine (LOCALHOST, and no peers elsewhere), sockets are
    bound to the loopback interface. The profile says all that the range would, so the middleware
    is told to change nothing of it: with LOCALHOST it binds to every interface. The range stays
    where another ROS or another middleware may not read the profile.

    :raises MiddlewareError: ROS cannot start with the settings of the shell.
    """
    check_settings()
    _await_network()
    quick, loopback = (
        str(files('humanopts_ros') / name)
        for name in ('quick_discovery.xml', 'loopback_discovery.xml')
    )
    given = {os.environ[name] for name in PROFILES if name in os.environ}
    if given - {loopback} or (not given and _USUAL_PROFILES.exists()):
        return  # profiles of the user; the loopback's are by the process that started this one
    rmw = os.environ.get('RMW_IMPLEMENTATION') or _READERS[1]
    stays = stays_here() and (os.environ.get('ROS_DISTRO'), rmw) == _READERS
    if stays:
        os.environ[RANGE] = 'SYSTEM_DEFAULT'
    os.environ[READ_PROFILES] = '1'
    os.environ.update(dict.fromkeys(PROFILES, loopback if stays or given else quick))


def on_loopback() -> bool:
    """Return whether this process's graph is known to be on the loopback interface alone."""
    rmw = os.environ.get('RMW_IMPLEMENTATION') or _READERS[1]
    mine = os.environ.get(PROFILES[0], '').endswith('loopback_discovery.xml')
    return mine and (os.environ.get('ROS_DISTRO'), rmw) == _READERS


def _await_network() -> None:
    """Wait until this machine has addresses for the others, or say that it has none."""
    deadline = time.monotonic() + _NETWORK_WAIT
    while absent := _absent_networks():
        if time.monotonic() > deadline:
            print(
                f'no network is up towards {", ".join(absent)}: nodes there do not find this '
                'process; connect this machine, and start again',
                file=sys.stderr,
                flush=True,
            )
            return
        time.sleep(_LOOK_PERIOD)


def _absent_networks() -> list[str]:
    """Return the other machines that no interface leads to which is up and has a carrier."""
    wanted = static_peers()
    if stays_here() or os.environ.get(RANGE) not in ('SUBNET', 'LOCALHOST'):
        return []
    # An address and a route are there before the carrier, for a second or as long as no cable is.
    stats = psutil.net_if_stats()
    own = {
        entry.address
        for name, entries in psutil.net_if_addrs().items()
        if (link := stats.get(name.partition(':')[0])) is not None and link.isup
        for entry in entries
        if entry.family == socket.AF_INET
    }
    if not wanted:
        return [] if any(not a.startswith('127.') for a in own) else ['other machines']
    return [peer for peer in wanted if address_towards(peer) not in own]
