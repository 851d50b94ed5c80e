"""
A launch as a job of the shell: Ctrl-Z suspends it while its nodes continue.

The graph drops a process that is stopped for long, and its lesson is lost. Therefore, the shell
waits for a front process that does nothing else, and Ctrl-Z stops only this one. The launch and
the terminal's node continue in the background, keep control of the game, and do not use the
terminal until the person returns (``terminal.device``).
"""

import os
import signal
import sys

_FORWARDED = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
_FROM_A_PROCESS = 0  # largest si_code to forward; the terminal signals the launch directly
_front = 0  # process that the shell waits for; 0: this one


def fork_launch() -> int | None:
    """
    Fork; the calling process, which the shell waits for, returns when the launch has ended.

    Call this before ROS is loaded: a fork does not have the threads of its libraries.

    :return: the exit status of the launch; None: this process is the launch.
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
        for number in (signal.SIGTSTP, signal.SIGTTOU):  # inherited by its nodes
            signal.signal(number, signal.SIG_IGN)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        return None
    try:
        while True:
            ended, status = os.waitpid(launch, os.WNOHANG)
            if ended:
                code = os.waitstatus_to_exitcode(status)
                return code if code >= 0 else 128 - code
            received = signal.sigwaitinfo(noticed)
            if received.si_signo in _FORWARDED and received.si_code <= _FROM_A_PROCESS:
                os.kill(launch, received.si_signo)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def shell_job_ended() -> bool:
    """Return whether the front process was killed."""
    return _front not in (0, os.getppid())


def in_foreground(terminal: int) -> bool:
    """
    Return whether this job has the terminal, rather than the shell or another job.

    :param terminal: file descriptor of the terminal.
    """
    try:
        return os.tcgetpgrp(terminal) == os.getpgrp()
    except OSError:  # the terminal is gone
        return False
