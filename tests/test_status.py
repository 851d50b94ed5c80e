"""``humanopts status`` beside a running graph."""

import json
from pathlib import Path
import signal

from graph_support.command import Command
from humanopts_teach.cli import main
import pytest

NODES = ['conductor', 'game', 'learner', 'lesson', 'option_server', 'planner', 'recorder']


def test_it_tells_which_nodes_live_which_were_started_again_and_which_is_stopped(
    tmp_path: Path,
    domain_id: int,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def look() -> tuple[int, dict[str, object]]:
        status = main(['status', '--json'])
        return status, json.loads(capsys.readouterr().out)

    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain_id))
    assert look()[0] == 2
    command = Command(['up', 'taxi', '--out', tmp_path / 'out'], tmp_path, domain_id)
    try:
        command.until(lambda: 'ready' in command.output, 'the nodes')
        # A busy machine answers late, which is told as a fault.
        looks = []
        command.until(lambda: looks.append(look()) or looks[-1][0] == 0, 'all to be well')
        found = looks[-1][1]
        nodes = {node['name']: node for node in found['nodes']}
        assert list(nodes) == NODES
        assert [name for name in NODES if nodes[name]['answer'] is None] == ['conductor']
        assert {nodes[name]['state'] for name in NODES} == {'ready'}
        assert all(nodes[name]['pid'] in command.running() for name in NODES[1:])
        assert found['recorder']['missing'] == 0
        assert found['game'] == 'taxi'

        command.kill('learner', signal.SIGKILL)
        command.until(lambda: 'is started again' in command.errors, 'its restart')
        assert 'learner' in [node['name'] for node in look()[1]['nodes']]
        command.kill('game', signal.SIGSTOP)
        status, found = look()
        nodes = {node['name']: node for node in found['nodes']}
        assert status == 1
        stopped = f'is stopped; kill -CONT {nodes["game"]["pid"]} lets it go on'
        assert f'game {stopped}' in found['faults']
        assert nodes['learner']['restarts'] == 1
        command.until(lambda: f'the node game {stopped}' in command.errors, 'its name')
        command.kill('game', signal.SIGCONT)
        command.send(signal.SIGINT)
        assert command.ended(30.0) == 1
        assert 'the node learner ended once (by signal SIGKILL) and was started' in command.errors
    finally:
        command.close()


def test_a_namespace_that_is_none_is_bad_input(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['status', '--namespace', 'room']) == 2
    assert "'room' is not a namespace" in capsys.readouterr().err
