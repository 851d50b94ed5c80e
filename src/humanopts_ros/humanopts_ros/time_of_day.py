"""The time of day, which somebody may set while programs run."""

from collections.abc import Callable
import time

_SET = 1_000_000  # ns by which it differs from what a steady clock says only where it was set
_READINGS = 5  # at the start, of which the quickest counts: a process may pause in any


def _steady() -> int:
    """Return the time since the machine started, ns; also while it sleeps."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME)


class TimeOfDay:
    """
    The time of day at the start, and by how much it was set since.

    :ivar now: what it would be at the last look if nobody had set it, ns since the epoch.
    :ivar ahead: by how much it was set until then, ns.
    """

    def __init__(
        self,
        time_of_day: Callable[[], int] = time.time_ns,
        steady: Callable[[], int] = _steady,
    ) -> None:
        """
        Begin with the time of day.

        :param time_of_day: ns since the epoch.
        :param steady: ns since any time, by a clock that nobody sets.
        """
        self._time_of_day, self._steady = time_of_day, steady
        readings = [(steady(), time_of_day(), steady()) for _ in range(_READINGS)]
        _, self.now, after = min(readings, key=lambda reading: reading[2] - reading[0])
        self._begun, self.ahead = self.now - after, 0

    def look(self) -> int:
        """Return by how much the time of day was set since the last look, ns; mostly 0."""
        earliest = self._begun + self._steady()
        time_of_day = self._time_of_day()
        self.now, before = self._begun + self._steady(), self.ahead
        if not earliest - _SET <= time_of_day - before <= self.now + _SET:
            self.ahead = time_of_day - self.now
        return self.ahead - before
