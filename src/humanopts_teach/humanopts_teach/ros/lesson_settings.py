"""The parameters of the node ``lesson`` that its rules and its folder are made from."""

from pathlib import Path

from humanopts_learner.options.start_states import STRATEGIES
from humanopts_ros.node_base import NodeBase, StartError
from humanopts_teach.demos.store import DemonstrationStore, StoreError
from humanopts_teach.dialogue.lesson import LessonRules
from rcl_interfaces.msg import IntegerRange


def read_rules(node: NodeBase) -> LessonRules:
    """
    Read how start states are drawn, and when the lesson on an option ends.

    :raises StartError: there is no such strategy.
    """
    default = LessonRules()
    numbers = IntegerRange(from_value=1, to_value=1_000_000, step=1)
    seeds = IntegerRange(from_value=0, to_value=2**62, step=1)
    strategy = node.setting(
        'strategy', default.strategy, 'of start states: random, coverage or failures'
    )
    if strategy not in STRATEGIES:
        raise StartError(f'parameter strategy: {strategy!r} is none of {", ".join(STRATEGIES)}')
    return LessonRules(
        strategy,
        node.setting(
            'budget',
            default.budget,
            'demonstrations that are asked for at most for one option',
            integer_range=[numbers],
        ),
        node.setting('seed', 0, 'of every random draw', integer_range=[seeds]),
    )


def open_store(node: NodeBase) -> DemonstrationStore:
    """
    Open the folder of demonstrations, and log what was mended in it.

    :raises StartError: it cannot be used.
    """
    directory = node.setting('directory', 'demonstrations', 'folder of all demonstrations')
    try:
        store = DemonstrationStore(Path(directory))
    except StoreError as error:
        raise StartError(str(error)) from error
    for damage in store.damage:
        node.get_logger().warning(damage)
    return store
