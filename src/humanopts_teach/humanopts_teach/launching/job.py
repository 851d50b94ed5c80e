"""
A launch as a job of the shell that Ctrl-Z suspends, while its nodes go on.

A process that is stopped for long is forgotten by the others of the graph, and its lesson is lost.
So the shell waits for a process that does nothing else, and only that one is stopped: the launch
and the terminal's node go on behind it, hold control, and leave the terminal alone until the
person is back (``terminal.device``).
"""

import os
import signal
import sys

_FORWARDED = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
_FROM_A_PROCESS = 0  # si_code, at most; those of the terminal reach the launch by themselves
_front = 0  # the process that stands in front of this one; 0: none does


def stand_in_front() -> int | None:
    """
    Fork; the process that the shell waits for stays here until the launch behind it ends.

    It comes before ROS is loaded, whose libraries start threads that a fork would not have.

    :return: the exit status of the launch; None: this is the launch, which goes on.
    """
    global _front
    assert 'rclpy' not in sys.modules, 'the fork comes too late'
    sys.stdout.flush()
    sys.stderr.flush()
    noticed = {*_FORWARDED, signal.SIGCHLD}
    before, front = signal.pthread_sigmask(signal.SIG_BLOCK, noticed), os.getpid()
    launch = os.fork()
    if launch == 0:
        _front = front
        for number in (signal.SIGTSTP, signal.SIGTTOU):  # by those that it starts, too
            signal.signal(number, signal.SIG_IGN)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        return None
    try:
        while True:
            ended, status = os.waitpid(launch, os.WNOHANG)
            if ended:
                code = os.waitstatus_to_exitcode(status)
                return code if code >= 0 else 128 - code
            came = signal.sigwaitinfo(noticed)
            if came.si_signo in _FORWARDED and came.si_code <= _FROM_A_PROCESS:
                os.kill(launch, came.si_signo)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def front_is_gone() -> bool:
    """Return whether the process that stood in front was killed."""
    return _front not in (0, os.getppid())


def in_foreground(terminal: int) -> bool:
    """
    Return whether a terminal is this job's, and not the shell's or another job's.

    :param terminal: its descriptor.
    """
    try:
        return os.tcgetpgrp(terminal) == os.getpgrp()
    except OSError:  # it is gone
        return False
