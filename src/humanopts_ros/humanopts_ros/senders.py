"""
The permitted publisher of each topic, for the nodes of a graph and for the readers of bags.

A message identifies its publisher by an id such as ``/game#1a2b3c4d``: the full name of the node
and a part that changes with each restart. Since any process could use any name, each node also
announces its id in the graph, with a publisher on ``_node/NAME/_PART``: a hidden topic that never
carries a message. The game, which may have any name, uses ``_game/NAME/_PART``.
"""

from typing import Literal

from humanopts_ros.recording import own_name, prefix_of

Role = Literal['node', 'game']
GAME_TOPICS = frozenset(
    {'domain_info', 'game_state', 'current_state', 'control', 'action_refused'}
)
_TOPICS = {
    'lesson': ('lesson_state',),
    'learner': ('learned_options', 'learning_status', 'demonstration_receipts'),
    'option_server': ('option_goals', 'option_results', 'available_options'),
    'planner': (
        *('automatic_options', 'option_values', 'execution'),
        *('plan_goals', 'plan_results', 'policy_goals', 'policy_results'),
        *('extraction_goals', 'extraction_results'),
    ),
    'recorder': ('recorder_status',),
}
# The only permitted publisher by topic name; any node may publish on other topics.
SENDERS = {topic: node for node, topics in _TOPICS.items() for topic in topics}


def signer(publisher_id: str) -> str:
    """Return the full name of the node in a publisher id; empty if the id is invalid."""
    name, mark, _ = publisher_id.partition('#')
    return name if mark else ''


def id_topic(publisher_id: str, role: Role) -> str:
    """Return the topic, relative to the namespace, that announces a node's id."""
    name, _, part = publisher_id.rpartition('/')[2].partition('#')
    return f'_{role}/{name}/_{part}'


def announced_id(topic: str, namespace: str, role: Role) -> str:
    """Return the id announced by a topic, given by its full name; empty if none."""
    prefix = prefix_of(namespace)
    name, mark, part = topic.removeprefix(f'{prefix}_{role}/').partition('/_')
    return f'{prefix}{name}#{part}' if mark and topic.startswith(f'{prefix}_{role}/') else ''


def sender_of(topic: str, namespace: str) -> str:
    """
    Return the full name of the node that may publish on a topic in a namespace.

    :param topic: full name of the topic.
    :return: full node name; empty if any node may publish, or for the topics of the game.
    """
    node = SENDERS.get(own_name(topic, namespace), '')
    return prefix_of(namespace) + node if node else ''
