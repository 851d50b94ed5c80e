"""What a node's process does about signals."""

import os
import signal
import threading

from humanopts_ros.process import woken_by_signals


def test_a_signal_wakes_a_waiting_executor() -> None:
    woken = threading.Event()
    former = signal.signal(signal.SIGUSR1, lambda number, frame: None)
    try:
        with woken_by_signals(woken.set):
            os.kill(os.getpid(), signal.SIGUSR1)
            assert woken.wait(5.0)
        assert signal.set_wakeup_fd(-1) == -1, 'the former setting is restored'
    finally:
        signal.signal(signal.SIGUSR1, former)
