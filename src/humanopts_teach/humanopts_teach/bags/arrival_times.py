"""When messages arrived at the recorder, although somebody sets the time of day."""

from collections.abc import Callable
import time

_SET = 1_000_000  # ns by which clocks differ from now on where somebody has set the time of day


def steady_ns() -> int:
    """Return the time since the machine started, ns; also while it sleeps."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME)


class ArrivalTimes:
    """
    Arrival times that begin at the time of day and run steadily from there, ns since the epoch.

    The middleware notes the time of day when a message arrives. That somebody set it is seen at the
    next look. What arrived between two looks arrived before it was set or after: of the two times
    that it may mean, one is between the looks.

    :ivar now: at the last look.
    """

    def __init__(
        self,
        time_of_day: Callable[[], int] = time.time_ns,
        steady: Callable[[], int] = steady_ns,
    ) -> None:
        """
        Begin at the time of day.

        :param time_of_day: ns since the epoch; may be set.
        :param steady: ns since any time.
        """
        self._time_of_day, self._steady = time_of_day, steady
        self._begun = time_of_day() - steady()
        self._ahead = self._ahead_before = 0  # by how much the time of day was set since, ns
        self.now = self._looked_before = self._begun + steady()
        self._newest: dict[str, int] = {}  # by topic

    def look(self) -> None:
        """See whether the time of day was set; to be called just after messages were taken."""
        earliest = self._begun + self._steady()
        time_of_day = self._time_of_day()
        self._looked_before, self.now = self.now, self._begun + self._steady()
        self._ahead_before = self._ahead
        if not earliest - _SET <= time_of_day - self._ahead <= self.now + _SET:
            self._ahead = time_of_day - self.now

    def of(self, topic: str, received: int) -> int:
        """
        Return when a message arrived: not before those of its topic that were taken earlier.

        :param received: the time of day then, ns since the epoch.
        """
        arrived = received - self._ahead
        if not self._looked_before <= arrived <= self.now:
            arrived = min(received - self._ahead_before, self.now)
        newest = self._newest[topic] = max(arrived, self._newest.get(topic, 0))
        return newest
