"""
What humanopts does about faults of the middleware and the C library, each with its source.

Nothing here imports ROS: what watches a node gets it from outside.
"""

from collections.abc import Callable
from contextlib import suppress
import ctypes
from importlib.resources import files
import os
from pathlib import Path
import signal
import socket
import sys
import threading
import time
from typing import Any

from humanopts_ros.middleware import (
    address_towards,
    check_settings,
    PROFILES,
    RANGE,
    static_peers,
    stays_here,
)
import psutil

# Discovery. With LOCALHOST Fast DDS sockets are bound to every interface, and nodes on the
# network are heard: https://github.com/ros2/rmw_fastrtps/issues/821
# Interfaces are looked at once, at the start: https://github.com/eProsima/Fast-DDS/issues/1880

READ_PROFILES = 'RMW_FASTRTPS_USE_QOS_FROM_XML'  # '1': what a profile says of memory, too
_READERS = 'jazzy', 'rmw_fastrtps_cpp'  # distribution and middleware that read both profiles
_USUAL_PROFILES = Path('DEFAULT_FASTRTPS_PROFILES.xml')  # of the working folder: read, too
_NETWORK_WAIT = 10.0  # s
_NETWORK_PERIOD = 0.05  # s between looks


def prepare_discovery() -> None:
    """
    Make Fast DDS announce this process often and give memory back, unless the user has profiles.

    Where the graph spans machines this waits for their network: a process announces the addresses
    that it has when it joins the graph, and never others.

    Where the graph is to stay on this machine (LOCALHOST, and no peers elsewhere), sockets are
    bound to the loopback interface by a profile, which says all that the range would, so the
    range is set to change nothing of it. The range stays where another ROS or another
    middleware may not read the profile.

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
    stays = stays_here() and _reads_profiles()
    if stays:
        os.environ[RANGE] = 'SYSTEM_DEFAULT'
    os.environ[READ_PROFILES] = '1'
    os.environ.update(dict.fromkeys(PROFILES, loopback if stays or given else quick))


def on_loopback() -> bool:
    """Return whether this process's graph is known to be on the loopback interface alone."""
    mine = os.environ.get(PROFILES[0], '').endswith('loopback_discovery.xml')
    return mine and _reads_profiles()


def _reads_profiles() -> bool:
    rmw = os.environ.get('RMW_IMPLEMENTATION') or _READERS[1]
    return (os.environ.get('ROS_DISTRO'), rmw) == _READERS


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
        time.sleep(_NETWORK_PERIOD)


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


# The time of day. Fast DDS ends its waits by it: where it is set back, a wait for what does not
# come lasts as much longer: https://github.com/ros2/ros2/issues/1080

_SET = 1_000_000  # ns; smaller differences from the steady clock are ignored
_READINGS = 5  # of which the quickest counts: the process may pause in any
_TIME_PERIOD = 0.5  # s between looks at the time of day


class TimeOfDay:
    """
    The time of day at the start, and by how much it was set since.

    :ivar now: what it would be at the last look had it not been set, ns since the epoch.
    :ivar ahead: by how much it was set until then, ns.
    """

    def __init__(
        self,
        time_of_day: Callable[[], int] = time.time_ns,
        steady: Callable[[], int] = lambda: time.clock_gettime_ns(time.CLOCK_BOOTTIME),
    ) -> None:
        """
        Begin with the time of day.

        :param time_of_day: ns since the epoch.
        :param steady: ns since any time, by a clock that cannot be set; it goes on in a sleep.
        """
        self._time_of_day, self._steady = time_of_day, steady
        self.now, after = self._read()
        self._begun, self.ahead = self.now - after, 0

    def look(self) -> int:
        """Return by how much the time of day was set since the last look, ns; mostly 0."""
        time_of_day, after = self._read()
        self.now, before = self._begun + after, self.ahead
        if abs(time_of_day - self.now - before) > _SET:
            self.ahead = time_of_day - self.now
        return self.ahead - before

    def _read(self) -> tuple[int, int]:
        """Return the time of day and the steady time at the same moment, ns."""
        steady, read = self._steady, self._time_of_day
        readings = [(steady(), read(), steady()) for _ in range(_READINGS)]
        _, time_of_day, after = min(readings, key=lambda reading: reading[2] - reading[0])
        return time_of_day, after


def watch_time(node: Callable[[], Any]) -> None:
    """
    Call ``tell_time_set`` of a node, in another thread, whenever the time of day is set.

    :param node: returns the node; None: it is gone.
    """

    def watch() -> None:
        time_of_day = TimeOfDay()
        while True:
            time.sleep(_TIME_PERIOD)
            watched = node()
            if watched is None or watched.destroyed:
                return
            if by := time_of_day.look():
                watched.tell_time_set(by / 1e9)
            del watched  # so that it is free while this sleeps

    threading.Thread(target=watch, daemon=True).start()


# The allocator. Readers of the middleware use much memory for a while, and glibc keeps what they
# free: https://github.com/eProsima/Fast-DDS/issues/5180

_GIVING_BACK = 5.0  # s between two givings back of memory, which take 0.3 ms each


class MemoryReturn:
    """Gives memory that is free back to the operating system, now and then."""

    def __init__(self, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._monotonic, self._due = monotonic, 0.0
        self._trim = getattr(ctypes.CDLL(None), 'malloc_trim', None)  # of glibc

    def __call__(self) -> None:
        """Give memory back if it is time to; to be called often."""
        if self._trim is not None and (now := self._monotonic()) >= self._due:
            self._due = now + _GIVING_BACK
            self._trim(0)


# Timers. While a callback blocks, as one that publishes to a reader which has stopped, an
# EventsExecutor gathers many calls of one timer: https://github.com/ros2/rclcpp/issues/2771
# In rclpy 7.1.5 each puts the next one off by a period, so that timers rest for minutes.

_TIMER_PERIOD = 0.5  # s between looks at timers


def reset_postponed(node: Any) -> None:
    """Reset the timers of a node whose next call is further away than their period."""
    for timer in list(node.timers):
        with suppress(RuntimeError):  # it was destroyed just now
            left = timer.time_until_next_call()  # ns; None: it is cancelled
            if left is not None and left > timer.timer_period_ns:
                timer.reset()


def look_after_timers(node: Any, ended: threading.Event) -> None:
    """Reset postponed timers of a node, in another thread, until it has ended."""

    def look() -> None:
        while not ended.wait(_TIMER_PERIOD):
            reset_postponed(node)

    threading.Thread(target=look, daemon=True).start()


# Leaving. Where participants leave at once, Fast DDS hangs now and then:
# https://github.com/eProsima/Fast-DDS/issues/6193

_LEAVING = 5  # s to leave the graph


def limit_leaving(seconds: int | None = None) -> None:
    """
    Let SIGALRM end this process if it does not leave the graph in time.

    The node is closed, and what it sent is taken by then.

    :param seconds: 0: no more; None: the usual time.
    """
    signal.alarm(_LEAVING if seconds is None else seconds)


# Pauses. After 20 s without a sign of a process others forget it, and it forgets them, but not at
# the same moment: then Fast DDS may never connect them again:
# https://github.com/eProsima/Fast-DDS/issues/457

MAX_PAUSE = 15.0  # s that a process may be stopped
