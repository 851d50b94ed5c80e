"""
A launch as a job of the shell: Ctrl-Z suspends it while its nodes continue.

The graph forgets a process that is stopped for long, and its lesson is lost. So the shell waits
for a process that does nothing else, and Ctrl-Z stops only that one. The launch and the terminal's
node continue behind it, keep control of the game, and leave the terminal alone until the person is
back (``terminal.device``).
"""

import os
import signal
import sys

_FORWARDED = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
_FROM_A_PROCESS = 0  # largest si_code; the launch receives those of the terminal directly
_front = 0  # process that the shell waits for; 0: this one


def fork_launch() -> int | None:
    """
    Fork; the process that the shell waits for stays here until the launch behind it ends.

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
    """Return whether the process that the shell waits for was killed."""
    return _front not in (0, os.getppid())


def in_foreground(terminal: int) -> bool:
    """
    Return whether this job has the terminal, rather than the shell or another job.

    :param terminal: its descriptor.
    """
    try:
        return os.tcgetpgrp(terminal) == os.getpgrp()
    except OSError:  # it is gone
        return False
