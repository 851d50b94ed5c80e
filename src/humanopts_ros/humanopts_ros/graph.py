"""What the graph tells of its nodes."""

from humanopts_ros.senders import game_of_mark
from rclpy.node import Node

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


def game_ids(node: Node) -> list[str]:
    """Return the publisher ids of the games in the namespace of a node, as they state them."""
    stated = {
        game_of_mark(topic, node.get_namespace()): topic
        for topic, _ in node.get_topic_names_and_types()
    }
    return sorted(
        publisher_id
        for publisher_id, topic in stated.items()
        if publisher_id and node.count_publishers(topic)  # a mere subscriber states nothing
    )
