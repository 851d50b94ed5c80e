"""Whether a recorder keeps up with what is sent."""

from dataclasses import dataclass
import math

LIMIT = 0.5  # s; a message that waits longer was taken too late
_CALM = 1.0  # s without one after which the recorder keeps up again


@dataclass
class Pace:
    """How long messages wait for a recorder; times are in seconds, by a clock that never jumps."""

    _longest: float = 0.0  # since the last report
    _late: float = -math.inf  # when a message was taken too late
    _taken: float = math.inf  # when messages were last taken

    def took(self, now: float, waited: float) -> None:
        """
        Count one taking of all that had arrived.

        A process that is stopped does not see when messages arrive, so that the time since it
        last took any counts where it is too long.

        :param waited: since the first of them arrived; 0: none had.
        """
        pause = now - self._taken
        self._taken = now
        waited = max(waited, pause if pause > LIMIT else 0.0)
        self._longest = max(self._longest, waited)
        if waited > LIMIT:
            self._late = now

    def behind(self, now: float) -> bool:
        """Tell whether messages wait too long."""
        return now - self._late < _CALM

    def report(self) -> float:
        """Return how long a message waited at most since the last report."""
        longest, self._longest = self._longest, 0.0
        return longest
