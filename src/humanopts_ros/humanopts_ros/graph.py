"""What the graph tells of its nodes."""

from rclpy.node import Node, NodeNameNonExistentError

_UNKNOWN = '_UNKNOWN_'  # in the name of a node of which only a topic or service is found yet


def node_names(node: Node) -> list[str]:
    """Return the full names of all nodes on the graph; any process may use any name."""
    found = node.get_node_names_and_namespaces()
    return [f'{namespace.rstrip("/")}/{name}' for name, namespace in found]


def publishers_of(node: Node, topic: str) -> list[str]:
    """Return the full name of the node of each publisher of a topic, where it is known."""
    found = node.get_publishers_info_by_topic(topic)
    names = (f'{each.node_namespace.rstrip("/")}/{each.node_name}' for each in found)
    return [name for name in names if _UNKNOWN not in name]


def serves(node: Node, name: str, service: str) -> bool:
    """
    Return whether a node serves a service, as far as the graph is known.

    :param node: that looks at the graph.
    :param name: full name of the other node.
    :param service: name of the service, relative to the namespace of ``node``.
    """
    if name not in node_names(node):
        return False
    namespace, _, own = name.rpartition('/')
    try:
        served = node.get_service_names_and_types_by_node(own, namespace or '/')
    except NodeNameNonExistentError:  # it has gone just now
        return False
    return node.resolve_service_name(service) in (each for each, _ in served)


def servers_of(node: Node, service: str) -> list[str]:
    """
    Return the full names of the nodes that serve a service, as far as the graph is known.

    :param service: its name, relative to the namespace of ``node``.
    """
    if node.resolve_service_name(service) not in dict(node.get_service_names_and_types()):
        return []
    return sorted({name for name in node_names(node) if serves(node, name, service)})
