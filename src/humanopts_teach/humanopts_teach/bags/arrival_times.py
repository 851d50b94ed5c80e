"""Arrival times of messages at the recorder, unaffected by changes of the system clock."""

from humanopts_ros.workarounds import TimeOfDay


class ArrivalTimes:
    """
    Arrival times that start at the time of day and increase steadily, ns since the epoch.

    The middleware stamps an arriving message with the time of day. A change of the clock is
    detected at the next look. A message that arrived between two looks was stamped before or
    after the change: usually only one of the two interpretations is between the looks. A message
    left over from earlier fits neither, and gets the time of the earlier look.

    :ivar now: at the last look.
    """

    def __init__(self, time_of_day: TimeOfDay) -> None:
        self._time_of_day = time_of_day
        self.now = self._looked_before = time_of_day.now
        self._ahead_before = 0  # offset of the time of day at that look, ns
        self._newest: dict[str, int] = {}  # by topic

    def look(self) -> None:
        """Detect changes of the time of day; call it just after taking messages."""
        self._looked_before, self._ahead_before = self.now, self._time_of_day.ahead
        self._time_of_day.look()
        self.now = self._time_of_day.now

    def of(self, topic: str, received: int) -> int:
        """
        Return the arrival time of a message, at or after those taken earlier from its topic.

        :param received: its time of day, ns since the epoch.
        """
        arrived = received - self._time_of_day.ahead
        if not self._looked_before <= arrived <= self.now:
            earliest = self._looked_before if self._time_of_day.ahead else 0
            arrived = min(max(received - self._ahead_before, earliest), self.now)
        newest = self._newest[topic] = max(arrived, self._newest.get(topic, 0))
        return newest
