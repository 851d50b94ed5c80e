"""Arrival times of messages at the recorder, unaffected by changes of the system clock."""

from humanopts_ros.workarounds import TimeOfDay


class ArrivalTimes:
    """
    Arrival times that start at the time of day and increase steadily, ns since the epoch.

    The middleware notes the time of day when a message arrives. That somebody set it is seen at
    the next look. What arrived between two looks arrived before it was set or after: of the two
    times that it may mean, mostly one is between the looks. What was left from before, and fits
    neither, is put at the earlier look.

    :ivar now: at the last look.
    """

    def __init__(self, time_of_day: TimeOfDay) -> None:
        self._time_of_day = time_of_day
        self.now = self._looked_before = time_of_day.now
        self._ahead_before = 0  # by how much the time of day was set then, ns
        self._newest: dict[str, int] = {}  # by topic

    def look(self) -> None:
        """See whether the time of day was set; to be called just after messages were taken."""
        self._looked_before, self._ahead_before = self.now, self._time_of_day.ahead
        self._time_of_day.look()
        self.now = self._time_of_day.now

    def of(self, topic: str, received: int) -> int:
        """
        Return when a message arrived: not before those of its topic that were taken earlier.

        :param received: the time of day then, ns since the epoch.
        """
        arrived = received - self._time_of_day.ahead
        if not self._looked_before <= arrived <= self.now:
            earliest = self._looked_before if self._time_of_day.ahead else 0
            arrived = min(max(received - self._ahead_before, earliest), self.now)
        newest = self._newest[topic] = max(arrived, self._newest.get(topic, 0))
        return newest
