"""Play Taxi with a behaviour tree of two taught options, next to a running graph."""

from execute_option import ExecuteOption
from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Sequence
from py_trees.decorators import Timeout
from py_trees.display import unicode_tree
from py_trees.trees import BehaviourTree
import rclpy
from rclpy.signals import SignalHandlerOptions

PERIOD = 0.05  # s between ticks


def create_root() -> Behaviour:
    """Return the tree: fetch the passenger, then deliver them, each within a minute."""
    root = Sequence('deliver', memory=True)
    for option in ('go to passenger and pickup', 'go to destination and dropoff'):
        root.add_child(Timeout(f'{option} in time', ExecuteOption(option), duration=60.0))
    return root


def main() -> None:
    """Tick the tree until it has succeeded or failed, and show it when it changes."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # Ctrl-C cancels the run first
    node = rclpy.create_node('taxi_tree')
    tree = BehaviourTree(create_root())
    tree.setup(node=node)
    shown = ''
    node.create_timer(PERIOD, tree.tick)
    try:
        while tree.root.status not in (Status.SUCCESS, Status.FAILURE):
            rclpy.spin_once(node, timeout_sec=PERIOD)
            if (text := unicode_tree(tree.root, show_status=True)) != shown:
                print(shown := text)
    except KeyboardInterrupt:
        tree.root.stop(Status.INVALID)
        rclpy.spin_once(node, timeout_sec=PERIOD)
    finally:
        tree.shutdown()
        rclpy.try_shutdown()


if __name__ == '__main__':
    main()
