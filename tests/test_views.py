"""What RViz, Foxglove and ROS's own tools see: the board, the option that runs, /diagnostics."""

import json
from pathlib import Path
import re
import signal
import sys
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from graph_support.live import GAME, Graph, RECORDER
from humanopts_interfaces.msg import (
    NodeStatus,
    OptionGoal,
    OptionResult,
    OptionValues,
    RecorderStatus,
)
from humanopts_interfaces.srv import ResetGame
from humanopts_ros.codec import uuid_to_message
from humanopts_ros.qos import CURRENT, LATCHED, STREAM
from humanopts_teach.ros.diagnostics import of_node, of_recording
from nav_msgs.msg import OccupancyGrid
import numpy as np
import pytest
from unique_identifier_msgs.msg import UUID
from visualization_msgs.msg import Marker, MarkerArray
import yaml

VIEWS = 'humanopts_teach.ros.views:ViewsNode'
ROOT = Path(__file__).parents[1]
VIEWERS = ROOT / 'src' / 'humanopts_teach' / 'viewers'
LAYERS = {'board', 'notes', 'option', 'signs', 'values'}


SERVER = '/room/option_server#1'
RUN = uuid_to_message('00000000-0000-4000-8000-000000000001')


def texts(array: MarkerArray, layer: str) -> list[str]:
    return [marker.text for marker in array.markers if marker.ns == layer and marker.text]


def agent(array: MarkerArray) -> tuple[float, float]:
    (marker,) = (m for m in array.markers if m.text == '☻')
    return marker.pose.position.x, marker.pose.position.y


def test_a_game_is_shown_in_its_namespace(live: Graph) -> None:
    live.start(GAME, '/room', domain='rooms')
    live.start(VIEWS, '/room')
    live.ready('/room/game', '/room/views')
    page = (ROOT / 'docs/reference/graph.md').read_text('utf-8')
    rows = re.findall(r'^\| `(views/\w+)` \| `([\w/]+)` \| latched \|', page, re.M)
    there = dict(live.node.get_topic_names_and_types())
    assert len(rows) == 2
    assert all(there[f'/room/{name}'] == [kind] for name, kind in rows)
    for start in ('cell 1,1', 'cell 2,3'):
        live.ask(ResetGame, '/room/reset_game', source=1, start_state=start)
    early = live.listen(MarkerArray, '/room/views/markers', CURRENT)
    live.until(lambda: early and agent(early[-1]) == (3.5, 8.5), 'the newest state')
    boards = live.listen(OccupancyGrid, '/room/views/board', CURRENT)
    late = live.listen(MarkerArray, '/room/views/markers', CURRENT)
    live.until(lambda: boards and late, 'the latched views')
    assert agent(late[0]) == (3.5, 8.5)  # the newest, not all of them

    (board,) = boards
    assert board.header.frame_id == 'room/humanopts'
    assert (board.info.width, board.info.height, board.info.resolution) == (45, 45, 0.25)
    assert set(board.data) == {0, 100}
    drawn = late[-1].markers
    assert drawn[0].action == Marker.DELETEALL
    assert {marker.header.frame_id for marker in drawn} == {'room/humanopts'}
    assert {marker.ns for marker in drawn[1:]} == {'board', 'notes', 'signs'}
    assert len({(marker.ns, marker.id) for marker in drawn}) == len(drawn)
    assert all(len(m.colors) in (0, len(m.points)) and m.color.a == 1.0 for m in drawn[1:])

    goals = live.node.create_publisher(OptionGoal, '/room/option_goals', STREAM)
    results = live.node.create_publisher(OptionResult, '/room/option_results', STREAM)
    plans = live.node.create_publisher(OptionValues, '/room/option_values', LATCHED)
    live.until(lambda: goals.get_subscription_count() == 1, 'the reader of goals')
    live.until(lambda: results.get_subscription_count() == 1, 'the reader of results')
    goals.publish(OptionGoal(publisher_id=SERVER, run_id=RUN, option_name='to the hallway'))
    live.until(lambda: texts(late[-1], 'option') == ['to the hallway'], 'the option')
    results.publish(OptionResult(publisher_id=SERVER, run_id=UUID()))  # of another run
    results.publish(OptionResult(publisher_id=SERVER, run_id=RUN))
    live.until(lambda: not texts(late[-1], 'option'), 'the end of the option')

    plan: dict[str, Any] = {'action_set': 'human', 'names': ['a', 'b'], 'states': [0, 1]}
    plan['publisher_id'] = '/room/planner#1'
    table = np.array([0.25, 0.5, -np.inf, -np.inf])
    plans.publish(OptionValues(**plan, option_values=table[:3], continuation_values=table))
    plans.publish(OptionValues(**plan, option_values=table, continuation_values=table))
    live.until(lambda: texts(late[-1], 'values'), 'the values')
    assert texts(late[-1], 'values') == ['human: 0.5 (blue) to 0.5 (yellow), goal G1']
    plans.publish(
        OptionValues(**plan, sampled=True, option_values=table, continuation_values=table)
    )
    live.until(lambda: not texts(late[-1], 'values'), 'no values of abstract states by cell')


def test_the_board_lies_in_a_frame_of_the_graph(live: Graph) -> None:
    messages = pytest.importorskip('tf2_msgs.msg')
    placed = live.listen(messages.TFMessage, '/tf_static', CURRENT)
    live.start(GAME, domain='rooms')
    live.start(VIEWS, frame_id='board', parent_frame='map', transform=[2.0, 0.0, 0.5, np.pi / 2])
    live.ready('/game', '/views')
    drawn = live.listen(MarkerArray, '/views/markers', CURRENT)
    live.until(lambda: placed and drawn, 'the transform and the board')
    assert {marker.header.frame_id for marker in drawn[-1].markers} == {'board'}
    (there,) = placed[0].transforms
    assert (there.header.frame_id, there.child_frame_id) == ('map', 'board')
    assert (there.transform.translation.x, there.transform.translation.z) == (2.0, 0.5)
    assert there.transform.rotation.z == pytest.approx(np.sqrt(0.5))


def test_without_tf2_msgs_one_line_says_so(
    live: Graph, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, 'tf2_msgs.msg', None)
    live.start(GAME, domain='rooms')
    live.start(VIEWS, parent_frame='map')
    live.ready('/views')
    said = capfd.readouterr().err
    assert said.count('no transform is published: install tf2_msgs') == 1
    assert 'four numbers' in live.refused(VIEWS, transform=[1.0])


def test_rviz_is_set_up_for_what_is_published() -> None:
    config = yaml.safe_load((VIEWERS / 'humanopts.rviz').read_text('utf-8'))[
        'Visualization Manager'
    ]
    displays = {display['Class']: display for display in config['Displays']}
    topics = {name.partition('/')[2]: each['Topic'] for name, each in displays.items()}
    assert {name: topic['Value'] for name, topic in topics.items()} == {
        'Map': '/views/board',
        'MarkerArray': '/views/markers',
    }
    assert {topic['Durability Policy'] for topic in topics.values()} == {'Transient Local'}
    assert set(displays['rviz_default_plugins/MarkerArray']['Namespaces']) == LAYERS
    assert config['Global Options']['Fixed Frame'] == 'humanopts'


def test_the_layout_of_foxglove_is_whole() -> None:
    layout = json.loads((VIEWERS / 'humanopts_foxglove.json').read_text('utf-8'))

    def panels(part: Any) -> set[str]:
        return {part} if isinstance(part, str) else panels(part['first']) | panels(part['second'])

    assert panels(layout['layout']) == set(layout['configById'])
    board = layout['configById']['3D!board']
    assert board['followTf'] == 'humanopts'
    assert set(board['topics']) == {'/views/board', '/views/markers'}
    assert set(board['topics']['/views/markers']['namespaces']) == LAYERS


DIAGNOSTICS = 'humanopts_teach.ros.diagnostics:DiagnosticsNode'
OK, WARN, ERROR, STALE = (
    DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR, DiagnosticStatus.STALE,
)  # fmt: skip


def test_the_nodes_and_the_recording_of_a_namespace_are_reported(
    live: Graph, tmp_path: Path
) -> None:
    arrays = live.listen(DiagnosticArray, '/diagnostics', STREAM)
    live.start(DIAGNOSTICS, '/room')
    live.start(GAME, '/room')
    recorder = live.spawn(RECORDER, '/room', path=tmp_path / 'bag')
    live.ready('/room/game', '/room/recorder')

    def levels() -> dict[str, bytes]:
        return {status.name: status.level for status in arrays[-1].status} if arrays else {}

    names = ('/room/diagnostics', '/room/game', '/room/recorder', '/room/recorder: bag')
    live.until(lambda: levels() == dict.fromkeys(names, OK), 'all to be well')
    recorder.kill(signal.SIGTERM)
    live.until(lambda: levels().get('/room/recorder') == STALE, 'the end of the recorder')
    values = {pair.key: pair.value for pair in arrays[-1].status[-1].values}
    assert values['path'] == str(tmp_path / 'bag')
    assert int(values['messages']) > 0


@pytest.mark.parametrize(
    ('state', 'there', 'level', 'word'),
    [
        (NodeStatus.STATE_READY, True, OK, 'ready'),
        (NodeStatus.STATE_STARTING, True, WARN, 'starting'),
        (NodeStatus.STATE_PAUSED, True, ERROR, 'paused'),
        (NodeStatus.STATE_STOPPING, False, STALE, 'stopped'),
        (NodeStatus.STATE_READY, False, STALE, 'gone'),
        (99, True, ERROR, 'unknown'),
    ],
)
def test_each_state_has_a_level(state: int, there: bool, level: bytes, word: str) -> None:
    status = NodeStatus(state=state, text='no room', node='/game')
    found = of_node(status, there)
    assert (found.name, found.level, found.message) == ('/game', level, f'{word}: no room')


def test_a_recording_has_a_level() -> None:
    for fields, level in (
        ({}, OK),
        ({'missing': 1}, WARN),
        ({'behind': True}, WARN),
        ({'complete': False}, WARN),
        ({'stopped': True}, ERROR),
    ):
        assert of_recording('bag', RecorderStatus(**{'complete': True, **fields})).level == level
