"""The selection of recorded topics, for the recorder and for the nodes that wait for it."""

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

GLOBAL = ('/rosout', '/parameter_events')  # recorded whatever the namespace
MOST_BYTES = 2**62  # largest allowed size of a file
NEEDED = ('demonstrations', 'domain_info')  # topics that an offline evaluation needs


@dataclass(frozen=True)
class Selection:
    """
    The topics of a namespace, and among them those that patterns choose.

    A pattern is a shell glob (``*``, ``?``, ``[...]``; ``*`` goes past ``/``, too), for the whole
    name of a topic or for what follows the namespace: ``lesson/*``.
    """

    namespace: str = '/'
    include: Sequence[str] = ()  # patterns; none: every topic
    exclude: Sequence[str] = ()  # patterns; they take precedence

    def wants(self, topic: str) -> bool:
        """Return whether a topic, by its full name, is recorded."""
        prefix = self._prefix
        if not topic.startswith(prefix) and topic not in GLOBAL:
            return False
        names = {topic, topic[1:], topic.removeprefix(prefix)}
        chosen = not self.include or _matches(names, self.include)
        return chosen and not _matches(names, self.exclude)

    @property
    def unevaluable(self) -> str:
        """Why a bag cannot be evaluated, in words; empty: it can."""
        lacking = [name for name in NEEDED if not self.wants(self._prefix + name)]
        if not lacking:
            return ''
        names = ' and '.join(lacking)
        return f'{names} will not be recorded: bag eval can learn nothing from this bag'

    @property
    def _prefix(self) -> str:
        return self.namespace.rstrip('/') + '/'


def _matches(names: set[str], patterns: Sequence[str]) -> bool:
    return any(fnmatchcase(name, pattern) for name in names for pattern in patterns)
