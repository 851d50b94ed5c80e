"""
Which node may publish what: one rule for the nodes of a graph and for the readers of bags.

A message names its publisher by an id such as ``/game#1a2b3c4d``: the full name of the node, and a
part that changes when the node is started again.

The game may be any node. It is the node that serves ``reset_game`` in the namespace; what it
announces on ``domain_info`` is the game. The other nodes are known by their names.
"""

from humanopts_ros.recording import own_name, prefix_of

GAME_SERVICE = 'reset_game'  # that the game, and no other node of its namespace, serves
GAME_TOPICS = frozenset(
    {'domain_info', 'game_state', 'current_state', 'control', 'action_refused'}
)
_TOPICS = {
    'lesson': ('lesson_state',),
    'learner': ('learned_options', 'learning_status', 'demonstration_receipts'),
    'option_server': ('option_goals', 'option_results'),
    'planner': (
        *('automatic_options', 'option_values', 'execution'),
        *('plan_goals', 'plan_results', 'policy_goals', 'policy_results'),
        *('extraction_goals', 'extraction_results'),
    ),
    'recorder': ('recorder_status',),
}
# The node that may publish on a topic, by the topic's name; on others, any node may.
SENDERS = {topic: node for node, topics in _TOPICS.items() for topic in topics}


def signer(publisher_id: str) -> str:
    """Return the full name of the node that signs so; empty: it is no signature."""
    name, mark, _ = publisher_id.partition('#')
    return name if mark else ''


def sender_of(topic: str, namespace: str) -> str:
    """
    Return the full name of the node that may publish on a topic of a namespace.

    :param topic: its full name.
    :return: empty: any node may, or it is a topic of the game.
    """
    node = SENDERS.get(own_name(topic, namespace), '')
    return prefix_of(namespace) + node if node else ''


def check_sender(publisher_id: str, sender: str) -> None:
    """
    Check that a message is from a node.

    :param sender: full name of the node.
    :raises ValueError: another node has published it.
    """
    if signer(publisher_id) != sender:
        raise ValueError(f'it is not from {sender}')
