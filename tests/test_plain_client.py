"""A client in plain rclpy, written from the documentation alone, on the graph of the rover."""

from pathlib import Path
import signal

from graph_support.live import (
    LEARNER,
    LESSON,
    open_graph,
    OPTION_SERVER,
    PLANNER,
    RECORDER,
    WORLD,
)
from teach_support.snapshot import check

CLIENT = Path(__file__).parent / 'graph_support/plain_client.py'
WORLD_FILE = Path(__file__).parents[1] / 'examples/humanopts_rover/worlds/rover.yaml'


def test_every_topic_service_and_action_is_as_documented(tmp_path: Path) -> None:
    with open_graph(tmp_path) as graph:
        rover = graph.run(['-m', 'humanopts_rover.node'], 'rover')
        graph.spawn(WORLD, world=WORLD_FILE)
        graph.spawn(LEARNER, directory=tmp_path / 'options')
        graph.spawn(LESSON, directory=tmp_path / 'demonstrations')
        for node in (OPTION_SERVER, PLANNER):
            graph.spawn(node)
        graph.spawn(RECORDER, path=tmp_path / 'bag', expect_recorder=False)
        graph.ready('/world', '/learner', '/lesson', '/option_server', '/planner', '/recorder')
        client = graph.run([str(CLIENT)], 'client', stdout=(tmp_path / 'list').open('wb'))
        graph.until(lambda: client.process.poll() is not None, 'the end of the client', 180.0)
        assert not client.process.poll(), client.said()
        rover.kill(signal.SIGKILL)  # as in test_own_robot.py
    check('plain_client.txt', (tmp_path / 'list').read_text('utf-8'))
