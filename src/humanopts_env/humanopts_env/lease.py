"""The lease of control, which ends unless its holder renews it."""

from collections import OrderedDict

CHECKS = 7  # maximum number of checks without a message from the holder
MAX_KNOWN = 1000  # known publishers


class Lease:
    """
    A lease of control; any message from its holder renews it.

    Silence is counted in checks, not in seconds, so that a delay of the game itself does not end
    the lease. A publisher id is a node name and a random part that changes when the node is
    restarted, such as ``/keyboard_teleop#1f0c33aa``.
    """

    def __init__(self) -> None:
        self._holder = ''
        self._silent = 0  # checks since the last message of the holder
        self._known: OrderedDict[str, None] = OrderedDict()  # publishers of statuses

    def begin(self, holder_id: str) -> None:
        """Start the lease of a holder; an empty id frees control."""
        self._holder, self._silent = holder_id, 0

    def knows(self, publisher_id: str) -> bool:
        """Return whether a publisher has published a status and has not ended."""
        return publisher_id in self._known

    def renew(self, publisher_id: str) -> None:
        """Renew the lease if a message is from its holder."""
        if publisher_id == self._holder:
            self._silent = 0

    def note_status(self, publisher_id: str, *, ended: bool = False) -> str:
        """
        Register a status of a publisher.

        :param ended: whether it is the last status.
        :return: reason why the lease ends now; empty if it continues.
        """
        self.renew(publisher_id)
        new = publisher_id not in self._known
        self._known[publisher_id] = None
        if ended:
            del self._known[publisher_id]
        elif len(self._known) > MAX_KNOWN:
            self._known.popitem(last=False)
        if not self._holder:
            return ''
        if ended:
            return f'{self._holder} has ended' if publisher_id == self._holder else ''
        again = new and publisher_id != self._holder and _node(publisher_id) == _node(self._holder)
        return f'{_node(publisher_id)} was restarted' if again else ''

    def check(self) -> str:
        """Count a check; return the reason why the lease ends now, or an empty text."""
        self._silent += 1
        if not self._holder or self._silent < CHECKS:
            return ''
        return f'{self._holder} is silent and has not renewed its control'


def _node(publisher_id: str) -> str:
    return publisher_id.split('#')[0]
