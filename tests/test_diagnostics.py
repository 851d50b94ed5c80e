"""What ROS's own tools see: /diagnostics says what nodes and recorder say of themselves."""

from pathlib import Path
import signal

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from graph_support.live import GAME, Graph, RECORDER
from humanopts_interfaces.msg import NodeStatus, RecorderStatus
from humanopts_ros.qos import STREAM
from humanopts_teach.ros.diagnostics import of_nodes, of_recording
import pytest

DIAGNOSTICS = 'humanopts_teach.ros.diagnostics:DiagnosticsNode'
OK, WARN, ERROR, STALE = (
    DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR, DiagnosticStatus.STALE,
)  # fmt: skip


def test_nodes_and_recording_of_a_namespace_are_told(live: Graph, tmp_path: Path) -> None:
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
    ('state', 'text', 'there', 'level', 'message'),
    [
        (NodeStatus.STATE_READY, '', True, OK, 'ready'),
        (NodeStatus.STATE_READY, '1 message refused', True, OK, 'ready: 1 message refused'),
        (NodeStatus.STATE_STARTING, '', True, WARN, 'starting'),
        (NodeStatus.STATE_PAUSED, 'no room', True, ERROR, 'paused: no room'),
        (NodeStatus.STATE_STOPPING, '', False, STALE, 'stopped'),
        (NodeStatus.STATE_READY, '', False, STALE, 'gone'),
        (99, '', True, ERROR, 'unknown'),
    ],
)
def test_each_state_has_a_level(
    state: int, text: str, there: bool, level: bytes, message: str
) -> None:
    status = NodeStatus(state=state, text=text, node='/game')
    (found,) = of_nodes({'/game': status}, {'/game'} if there else set())
    assert (found.name, found.level, found.message) == ('/game', level, message)


@pytest.mark.parametrize(
    ('fields', 'level'),
    [
        ({}, OK),
        ({'missing': 1}, WARN),
        ({'behind': True}, WARN),
        ({'complete': False}, WARN),
        ({'stopped': True}, ERROR),
    ],
)
def test_a_recording_has_a_level(fields: dict[str, object], level: bytes) -> None:
    assert of_recording('bag', RecorderStatus(**{'complete': True, **fields})).level == level
