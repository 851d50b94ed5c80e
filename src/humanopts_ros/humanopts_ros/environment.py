"""Environment variables that humanopts processes share."""

from importlib.resources import files
import os
import socket
import sys
import time

import psutil

LAUNCHER_PID = 'HUMANOPTS_LAUNCHER_PID'  # of the process that started a node; it ends with it
INSTANCE = 'HUMANOPTS_INSTANCE'  # how the publisher_id of a node ends that a launcher started
PROFILES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')  # Jazzy reads [0]
READ_PROFILES = 'RMW_FASTRTPS_USE_QOS_FROM_XML'  # '1': what a profile says of memory, too
RANGE, PEERS = 'ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_STATIC_PEERS'
_NETWORK_WAIT = 10.0  # s
_LOOK_PERIOD = 0.05  # s
_ANY_PORT = 7400  # nothing is sent to it


def prepare_discovery() -> None:
    """
    Make Fast DDS announce this process often and give memory back, unless the user has profiles.

    Where the graph spans machines this waits for their network: a process announces the addresses
    that it has when it joins the graph, and never others.

    Where the graph is to stay on this machine (LOCALHOST, and no peers elsewhere), sockets are
    bound to the loopback interface. The profile says all that the range would, so the middleware
    is told to change nothing of it: with LOCALHOST it binds to every interface.
    """
    _await_network()
    quick, loopback = (
        str(files('humanopts_ros') / name)
        for name in ('quick_discovery.xml', 'loopback_discovery.xml')
    )
    given = [os.environ[name] for name in PROFILES if name in os.environ]
    if given not in ([], [loopback]):  # the last: by the process that started this one
        return
    stays = os.environ.get(RANGE) == 'LOCALHOST' and not os.environ.get(PEERS)
    if stays:
        os.environ[RANGE] = 'SYSTEM_DEFAULT'
    os.environ[READ_PROFILES] = '1'
    os.environ[PROFILES[0]] = loopback if stays or given else quick


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
    chosen, peers = os.environ.get(RANGE), os.environ.get(PEERS, '')
    if chosen not in ('SUBNET', 'LOCALHOST'):
        return []
    wanted = [peer for each in peers.split(';') if (peer := each.strip())]
    if not wanted and chosen == 'LOCALHOST':
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
    return [peer for peer in wanted if _address_towards(peer) not in own]


def _address_towards(peer: str) -> str:
    """Return this machine's address on the way to another; empty: there is no way."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((peer, _ANY_PORT))
        except (OSError, UnicodeError):  # no route, or no such name
            return ''
        return str(probe.getsockname()[0])
