"""The time of day, which somebody may set while programs run."""

from collections.abc import Callable
import time

_SET = 1_000_000  # ns; a smaller difference from the steady clock is no setting
_READINGS = 5  # of which the quickest counts: the process may pause in any


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
