"""
Workarounds for defects of the middleware and the C library, each with a reference.

This module does not import ROS; nodes are passed in by the caller.
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
    is_local,
    PROFILES,
    RANGE,
    static_peers,
)
import psutil

# Discovery. Even with LOCALHOST, Fast DDS binds its sockets to every interface and discovers nodes
# on the network: https://github.com/ros2/rmw_fastrtps/issues/821
# Interfaces are enumerated only at startup: https://github.com/eProsima/Fast-DDS/issues/1880

READ_PROFILES = 'RMW_FASTRTPS_USE_QOS_FROM_XML'  # '1': also apply memory policies of profiles
_READERS = 'jazzy', 'rmw_fastrtps_cpp'  # distribution and middleware known to read profiles
_USUAL_PROFILES = Path('DEFAULT_FASTRTPS_PROFILES.xml')  # also read by Fast DDS
_NETWORK_WAIT = 10.0  # s
_NETWORK_PERIOD = 0.05  # s between checks


def prepare_discovery() -> None:
    """
    Make Fast DDS announce this process often and release memory, unless the user has profiles.

    If the graph spans machines, wait for the network: a process announces only the addresses that
    it has when it joins the graph.

    If the graph is restricted to this machine (LOCALHOST without peers), a profile binds the
    sockets to the loopback interface, and the range is set to a neutral value. Other ROS
    distributions and middlewares might not read the profile, so they keep the range.

    :raises MiddlewareError: ROS cannot start with the environment's settings.
    """
    check_settings()
    _await_network()
    quick, loopback = (
        str(files('humanopts_ros') / name)
        for name in ('quick_discovery.xml', 'loopback_discovery.xml')
    )
    given = {os.environ[name] for name in PROFILES if name in os.environ}
    if given - {loopback} or (not given and _USUAL_PROFILES.exists()):
        return  # user profiles; the loopback profile is inherited from the parent process
    stays = is_local() and _reads_profiles()
    if stays:
        os.environ[RANGE] = 'SYSTEM_DEFAULT'
    os.environ[READ_PROFILES] = '1'
    later = os.environ.get('ROS_DISTRO', '') > _READERS[0]  # alphabetical names
    names = PROFILES[1:] if later else PROFILES  # later distributions warn about the first
    os.environ.update(dict.fromkeys(names, loopback if stays or given else quick))


def on_loopback() -> bool:
    """Return whether this process's graph is known to use only the loopback interface."""
    own_profile = os.environ.get(PROFILES[0], '').endswith('loopback_discovery.xml')
    return own_profile and _reads_profiles()


def _reads_profiles() -> bool:
    rmw = os.environ.get('RMW_IMPLEMENTATION') or _READERS[1]
    return (os.environ.get('ROS_DISTRO'), rmw) == _READERS


def _await_network() -> None:
    """Wait for a network connection to every peer; report peers still without one."""
    deadline = time.monotonic() + _NETWORK_WAIT
    while absent := _absent_networks():
        if time.monotonic() > deadline:
            print(
                f'no network connection to {", ".join(absent)}: nodes there cannot find this '
                'process; connect this machine, and start again',
                file=sys.stderr,
                flush=True,
            )
            return
        time.sleep(_NETWORK_PERIOD)


def _absent_networks() -> list[str]:
    """Return the peers that are not reachable through an interface with a carrier."""
    wanted = static_peers()
    if is_local() or os.environ.get(RANGE) not in ('SUBNET', 'LOCALHOST'):
        return []
    # Address and route exist a second before the carrier, or even without a cable.
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


# System time. Fast DDS uses it for timeouts: if it is set back, timeouts are extended by the same
# amount: https://github.com/ros2/ros2/issues/1080

_SET = 1_000_000  # ns; smaller differences from the steady clock are ignored
_READINGS = 5  # readings; the fastest is used, since preemption delays others
_TIME_PERIOD = 0.5  # s between checks of the system time


class TimeOfDay:
    """
    A detector of changes of the system time.

    :ivar now: system time at the last check, without the detected changes, ns since the epoch.
    :ivar ahead: sum of the detected changes, ns.
    """

    def __init__(
        self,
        time_of_day: Callable[[], int] = time.time_ns,
        steady: Callable[[], int] = lambda: time.clock_gettime_ns(time.CLOCK_BOOTTIME),
    ) -> None:
        """
        Start from the current system time.

        :param time_of_day: system clock, ns since the epoch.
        :param steady: steady clock with arbitrary origin, ns; continues during suspend.
        """
        self._time_of_day, self._steady = time_of_day, steady
        self.now, after = self._read()
        self._begun, self.ahead = self.now - after, 0

    def check(self) -> int:
        """Return the offset by which the system time was set since the last check, ns."""
        time_of_day, after = self._read()
        self.now, before = self._begun + after, self.ahead
        if abs(time_of_day - self.now - before) > _SET:
            self.ahead = time_of_day - self.now
        return self.ahead - before

    def _read(self) -> tuple[int, int]:
        """Return simultaneous readings of the system clock and the steady clock, ns."""
        steady, read = self._steady, self._time_of_day
        readings = [(steady(), read(), steady()) for _ in range(_READINGS)]
        _, time_of_day, after = min(readings, key=lambda reading: reading[2] - reading[0])
        return time_of_day, after


def watch_time(node: Callable[[], Any]) -> None:
    """
    Call ``notify_time_set`` of a node, from another thread, whenever the system time is set.

    :param node: function that returns the node, or None if it is gone.
    """

    def watch() -> None:
        time_of_day = TimeOfDay()
        while True:
            time.sleep(_TIME_PERIOD)
            watched = node()
            if watched is None or watched.destroyed:
                return
            if by := time_of_day.check():
                watched.notify_time_set(by / 1e9)
            del watched  # hold no reference to the node while sleeping

    threading.Thread(target=watch, daemon=True).start()


# Allocator. Readers of the middleware temporarily use a lot of memory, and glibc does not return
# freed memory: https://github.com/eProsima/Fast-DDS/issues/5180

_GIVING_BACK = 5.0  # s between calls of malloc_trim, which take 0.3 ms each


class MemoryReturn:
    """Periodically returns free memory to the operating system."""

    def __init__(self, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._monotonic, self._due = monotonic, 0.0
        self._trim = getattr(ctypes.CDLL(None), 'malloc_trim', None)  # glibc only

    def __call__(self) -> None:
        """Return memory if the period has elapsed; call this frequently."""
        if self._trim is not None and (now := self._monotonic()) >= self._due:
            self._due = now + _GIVING_BACK
            self._trim(0)


# Executors. In rclpy 9.1.2 (Kilted), a process with an EventsExecutor and action servers ends with
# a segmentation fault when a goal is canceled or preempted.


def events_crash() -> bool:
    """Return whether the EventsExecutor of this distribution must not be used."""
    return os.environ.get('ROS_DISTRO') == 'kilted'


# Timers. While a callback blocks, for example because it publishes to a stalled reader, an
# EventsExecutor queues many calls of one timer: https://github.com/ros2/rclcpp/issues/2771
# In rclpy 7.1.5, each queued call delays the next by one period, so timers pause for minutes.

_TIMER_PERIOD = 0.5  # s between checks of timers


def reset_postponed(node: Any) -> None:
    """Reset a node's timers if their next call is more than one period away."""
    for timer in list(node.timers):
        with suppress(RuntimeError):  # it may just have been destroyed
            left = timer.time_until_next_call()  # ns; None: cancelled
            if left is not None and left > timer.timer_period_ns:
                timer.reset()


def restart_postponed_timers(node: Any, ended: threading.Event) -> None:
    """Reset postponed timers of a node, from another thread, until it has ended."""

    def reset() -> None:
        while not ended.wait(_TIMER_PERIOD):
            reset_postponed(node)

    threading.Thread(target=reset, daemon=True).start()


# Shutdown. If participants leave at the same time, Fast DDS occasionally hangs:
# https://github.com/eProsima/Fast-DDS/issues/6193

_LEAVING = 5  # s, time limit for leaving the graph


def limit_leaving(seconds: int | None = None) -> None:
    """
    Let SIGALRM end this process if it does not leave the graph in time.

    By then the node is closed and its messages have been received.

    :param seconds: time limit, s; 0 for none, None for the default.
    """
    signal.alarm(_LEAVING if seconds is None else seconds)


# Suspension. After 20 s without contact, processes drop each other, but not simultaneously; then
# Fast DDS may never reconnect them: https://github.com/eProsima/Fast-DDS/issues/457

MAX_PAUSE = 15.0  # s that a process may be suspended
