"""Which nodes were started again, by what they publish of their lives; strangers tell nothing."""

import itertools

from graph_support.live import Graph
from humanopts_interfaces.msg import NodeStatus
from humanopts_ros.node_base import NodeBase
from humanopts_ros.node_restarts import NodeRestarts
from humanopts_ros.qos import LATCHED_ALL

STARTING, READY, STOPPING = (
    NodeStatus.STATE_STARTING, NodeStatus.STATE_READY, NodeStatus.STATE_STOPPING,
)  # fmt: skip
WATCHER = f'{__name__}:Watcher'


class Watcher(NodeBase):
    """Keeps which nodes were started again, in order."""

    def __init__(self, **options: object) -> None:
        super().__init__('watcher', **options)
        self.found: list[str] = []
        self.restarts = NodeRestarts(self, self.found.append)


def test_a_restart_is_told_when_the_node_begins_and_when_it_is_ready(live: Graph) -> None:
    watcher = live.start(WATCHER, '/room')
    out = live.node.create_publisher(NodeStatus, '/room/node_status', LATCHED_ALL)
    live.until(out.get_subscription_count, 'the watcher to listen')

    number = itertools.count()

    def last() -> NodeStatus:
        """A status of another life of a node, by which a test sees that all was taken."""
        return NodeStatus(node='/room/last', publisher_id=f'/room/last#{next(number)}')

    def say(node: str, publisher: str, state: int, told: list[str]) -> None:
        watcher.found.clear()
        out.publish(NodeStatus(node=node, publisher_id=publisher, state=state))
        out.publish(last())
        live.until(lambda: 'last' in watcher.found, 'all to be taken')
        assert watcher.found == [*told, 'last']

    out.publish(last())
    say('/room/game', '/room/game#1', STARTING, [])
    say('/room/game', '/room/game#1', READY, [])
    say('/room/game', '/room/game#1', READY, [])
    say('/room/game', '/room/game#1', STOPPING, [])
    say('/room/game', '/room/game#2', STARTING, ['game'])
    say('/room/game', '/room/game#2', READY, ['game'])
    say('/room/game', '/room/game#2', READY, [])
    say('/room/game', '/room/game#3', READY, ['game'])  # its beginning was not heard
    say('/room/game', '/room/lesson#3', READY, [])  # signed by another
    say('/hall/game', '/hall/game#9', READY, [])  # of another namespace
    say('/hall/game', '/hall/game#10', READY, [])
    assert watcher.restarts.counts['game'] == 3
