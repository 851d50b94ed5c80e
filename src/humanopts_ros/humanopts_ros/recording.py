"""
Which topics a bag holds, for the recorder and for the nodes that wait for it.

A bag holds its own graph: the topics, service events and action messages of its nodes, in exactly
its namespace. Patterns add other topics, or leave some out.
"""

from collections.abc import Callable, Collection, Sequence, Set
from dataclasses import dataclass
from fnmatch import fnmatchcase

INTERFACES = 'humanopts_interfaces/'  # the package of the types of a graph
SHARED = ('/rosout', '/parameter_events')  # of all nodes; those of the own nodes are recorded
MAX_BYTES = 2**62  # largest allowed size of a file
NEEDED = ('demonstrations', 'domain_info')  # topics that an offline evaluation needs
_ACTION_STATUS = '/_action/status'
_HIDDEN = ('/_service_event', '/_action/feedback', _ACTION_STATUS)


def prefix_of(namespace: str) -> str:
    """Return what the full names in a namespace begin with."""
    return namespace.rstrip('/') + '/'


def own_name(topic: str, namespace: str) -> str:
    """
    Return the name of a topic, service or action that is directly in a namespace.

    :param topic: full name of the topic; service events and messages of actions count as the
        service or action.
    :return: its name in the namespace; empty: it is elsewhere, or deeper.
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

    It does if it is directly in the namespace and has a type of ours, or if a node of the graph
    publishes it there: with a type of ours, as the status of an action, or below its own name.

    :param kind: its type.
    :param own_nodes: full names of the nodes that publish their status in the namespace.
    :param publishers: returns the full names of the nodes that publish the topic; called where
        it matters only.
    """
    if not topic.startswith(prefix_of(namespace)):
        return False
    ours = kind.startswith(INTERFACES)
    if ours and own_name(topic, namespace):
        return True
    if ours or topic.endswith(_ACTION_STATUS):
        return not own_nodes.isdisjoint(publishers())
    below = {node for node in own_nodes if topic.startswith(f'{node}/')}
    return bool(below) and not below.isdisjoint(publishers())


@dataclass(frozen=True)
class Selection:
    """
    The topics of a bag: those of the graph of a namespace, and those that patterns add.

    A pattern is a shell glob (``*``, ``?``, ``[...]``; ``*`` goes past ``/``, too), for the whole
    name of a topic or for what follows the namespace: ``lesson/*``.
    """

    namespace: str = '/'
    record: Sequence[str] = ()  # patterns of topics to record beside those of the graph
    exclude: Sequence[str] = ()  # patterns of topics not to record; they take precedence

    def wants(self, topic: str, own: bool) -> bool:
        """
        Return whether a topic, by its full name, is recorded.

        :param own: it belongs to the graph, as ``is_own`` has it.
        """
        return (own or self.adds(topic)) and not self._matches(topic, self.exclude)

    def adds(self, topic: str) -> bool:
        """Return whether a pattern asks for a topic, whoever publishes it."""
        return self._matches(topic, self.record)

    def wants_own(self, topic: str) -> bool:
        """Return whether a topic of a node of the graph is recorded, by its full name."""
        return self.wants(topic, topic.startswith(prefix_of(self.namespace)))

    @property
    def unevaluable(self) -> str:
        """Why a bag cannot be evaluated, in words; empty: it can."""
        lacking = [n for n in NEEDED if not self.wants_own(prefix_of(self.namespace) + n)]
        if not lacking:
            return ''
        names = ' and '.join(lacking)
        return f'{names} will not be recorded: bag eval can learn nothing from this bag'

    def _matches(self, topic: str, patterns: Sequence[str]) -> bool:
        names = {topic, topic[1:], topic.removeprefix(prefix_of(self.namespace))}
        return any(fnmatchcase(name, pattern) for name in names for pattern in patterns)
