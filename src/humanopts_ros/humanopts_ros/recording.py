"""
The selection of recorded topics, for the recorder and for the nodes that wait for it.

A bag contains one graph: the topics, service events and action messages of its nodes, directly in
its namespace. Patterns add or exclude topics.
"""

from collections.abc import Callable, Collection, Sequence, Set
from dataclasses import dataclass
from fnmatch import fnmatchcase

INTERFACES = 'humanopts_interfaces/'  # package of the graph's message types
SHARED = ('/rosout', '/parameter_events')  # shared; only this graph's messages are recorded
MAX_BYTES = 2**62  # bytes of a file
NEEDED = ('demonstrations', 'domain_info')  # topics required for offline evaluation
_ACTION_STATUS = '/_action/status'
_HIDDEN = ('/_service_event', '/_action/feedback', _ACTION_STATUS)


def prefix_of(namespace: str) -> str:
    """Return the prefix of full names in a namespace."""
    return namespace.rstrip('/') + '/'


def own_name(topic: str, namespace: str) -> str:
    """
    Return the name of a topic, service or action directly in a namespace.

    :param topic: full name of the topic; service events and action messages are mapped to their
        service or action.
    :return: name in the namespace; empty if the topic is elsewhere or nested deeper.
    """
    prefix = prefix_of(namespace)
    if not topic.startswith(prefix):
        return ''
    name = topic.removeprefix(prefix)
    for suffix in _HIDDEN:
        name = name.removesuffix(suffix)
    return '' if '/' in name else name


def is_own(
    topic: str,
    kind: str,
    namespace: str,
    own_nodes: Set[str],
    publishers: Callable[[], Collection[str]],
) -> bool:
    """
    Return whether a topic belongs to the graph of a namespace.

    A topic with a humanopts type directly in the namespace belongs to it. Any other topic in the
    namespace must be published by a node of the graph, and have a humanopts type, be an action
    status, or be below the node's name.

    :param kind: type of the topic.
    :param own_nodes: full names of the nodes that publish their status in the namespace.
    :param publishers: function that returns the full names of the topic's publishers; called only
        if needed.
    """
    if not topic.startswith(prefix_of(namespace)):
        return False
    is_builtin = kind.startswith(INTERFACES)
    if is_builtin and own_name(topic, namespace):
        return True
    if is_builtin or topic.endswith(_ACTION_STATUS):
        return not own_nodes.isdisjoint(publishers())
    below = {node for node in own_nodes if topic.startswith(f'{node}/')}
    return bool(below) and not below.isdisjoint(publishers())


@dataclass(frozen=True)
class Selection:
    """
    The topics of a bag: the topics of a namespace's graph, modified by patterns.

    A pattern is a shell glob (``*``, ``?``, ``[...]``; ``*`` also matches ``/``) for the full name
    of a topic or for its name in the namespace, such as ``lesson/*``.
    """

    namespace: str = '/'
    record: Sequence[str] = ()  # patterns of additional topics to record
    exclude: Sequence[str] = ()  # patterns of topics not to record; they take precedence

    def wants(self, topic: str, own: bool) -> bool:
        """
        Return whether a topic, given by its full name, is recorded.

        :param own: whether the topic belongs to the graph, according to ``is_own``.
        """
        return (own or self.adds(topic)) and not self._matches(topic, self.exclude)

    def adds(self, topic: str) -> bool:
        """Return whether a pattern adds a topic, regardless of its publisher."""
        return self._matches(topic, self.record)

    def wants_own(self, topic: str) -> bool:
        """Return whether a topic of the graph, given by its full name, is recorded."""
        return self.wants(topic, topic.startswith(prefix_of(self.namespace)))

    @property
    def missing_for_evaluation(self) -> str:
        """The reason why a bag cannot be evaluated; empty if it can."""
        missing = [n for n in NEEDED if not self.wants_own(prefix_of(self.namespace) + n)]
        if not missing:
            return ''
        names = ' and '.join(missing)
        return f'{names} will not be recorded: bag eval can learn nothing from this bag'

    def _matches(self, topic: str, patterns: Sequence[str]) -> bool:
        names = {topic, topic[1:], topic.removeprefix(prefix_of(self.namespace))}
        return any(fnmatchcase(name, pattern) for name in names for pattern in patterns)
