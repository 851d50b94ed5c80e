"""Arrival times of messages at the recorder, unaffected by changes of the system clock."""

from humanopts_ros.workarounds import TimeOfDay


class ArrivalTimes:
    """
    Arrival times that start at the system time and increase steadily, ns since the epoch.

    The middleware stamps each arriving message with the system time. A clock change is detected at
    the next check. A message that arrived between two checks was stamped before or after the
    change. Usually only one of these interpretations lies between the checks. An older message
    matches neither, and gets the time of the earlier check.

    :ivar now: time of the last check.
    """

    def __init__(self, time_of_day: TimeOfDay) -> None:
        self._time_of_day = time_of_day
        self.now = self._checked_before = time_of_day.now
        self._ahead_before = 0  # ns, offset of the system time at the previous check
        self._newest: dict[str, int] = {}  # latest arrival by topic

    def check(self) -> None:
        """Detect changes of the system time; call this immediately after taking messages."""
        self._checked_before, self._ahead_before = self.now, self._time_of_day.ahead
        self._time_of_day.check()
        self.now = self._time_of_day.now

    def of(self, topic: str, received: int) -> int:
        """
        Return the arrival time of a message, never earlier than previous ones of its topic.

        :param received: system time stamp of the message, ns since the epoch.
        """
        arrived = received - self._time_of_day.ahead
        if not self._checked_before <= arrived <= self.now:
            earliest = self._checked_before if self._time_of_day.ahead else 0
            arrived = min(max(received - self._ahead_before, earliest), self.now)
        newest = self._newest[topic] = max(arrived, self._newest.get(topic, 0))
        return newest
