"""A demo survives the deaths of nodes; an interrupted one keeps its bag and leaves no process."""

from collections.abc import Callable, Iterator
import json
from pathlib import Path
import re
import shutil
import signal
from signal import SIGCONT, SIGINT, SIGKILL, SIGSTOP, SIGTERM
from typing import Any

from graph_support.command import Command, shown_in_bag, shown_on_disk
from humanopts_learner.demonstrations import Demonstration, GOAL
from humanopts_teach.bags.reader import Bag, BagError, open_bag
from humanopts_teach.cli import main
import pytest

SHOWN = 3  # demonstrations on disk before anything happens
EPISODES = 4  # played by the demo that survives the deaths of nodes
PATIENCE = 30.0  # s for a demo to end; it takes about one
NODES = [
    *('conductor', 'game', 'learner', 'lesson', 'option_server', 'planner', 'recorder'),
    'simulated_teacher',
]
Start = Callable[..., Command]
pytestmark = [pytest.mark.whole, pytest.mark.timeout(300)]  # on a busy machine


@pytest.fixture
def start(tmp_path: Path, domain_id: int, short_lease: None) -> Iterator[Start]:
    """Start a demo in ``tmp_path / 'out'``."""
    started = []

    def begin(*arguments: object) -> Command:
        command = Command(
            ['demo', '--out', tmp_path / 'out', '--seed', 3, *arguments], tmp_path, domain_id
        )
        started.append(command)
        return command

    yield begin
    for command in started:
        command.close()


def teach(command: Command, folder: Path) -> None:
    """Wait until it is in the middle of teaching."""
    command.until(lambda: len(shown_on_disk(folder / 'out')) >= SHOWN, 'demonstrations')


def bag_of(folder: Path) -> Bag:
    """Open the bag, whatever became of its recorder."""
    return open_bag(folder / 'out' / 'bag')


KILLED = 'by signal SIGKILL'
slow = pytest.mark.slow


def in_first_bag(folder: Path) -> list[Demonstration]:
    """Return the demonstrations that the recorder has written to the first bag so far."""
    try:
        return shown_in_bag(bag_of(folder))
    except BagError:  # nothing is written yet
        return []


def test_a_demo_survives_the_deaths_of_nodes_while_it_teaches_and_while_it_plays(
    start: Start, tmp_path: Path
) -> None:
    # The machine is paced, so that its play lasts until the planner is killed.
    command = start('--learn', GOAL, '--episodes', EPISODES, '--step-period', 0.05)
    command.until(lambda: in_first_bag(tmp_path), 'a demonstration in the bag', 3 * PATIENCE)
    before = in_first_bag(tmp_path)
    command.kill('recorder', SIGKILL)
    command.until(lambda: 'the node recorder ended' in command.errors, 'its end to be reported')
    command.kill('game', SIGKILL)
    command.until(lambda: 'playing' in command.output, 'the first episode', 3 * PATIENCE)
    command.kill('planner', SIGKILL)
    assert command.ended(3 * PATIENCE) == 1, command.errors
    assert 'an error in' not in command.errors
    command.gone(2.0)
    first, second = bag_of(tmp_path), open_bag(tmp_path / 'out' / 'bag-2')
    conductor = [
        r.message.text for r in second.messages(['/node_status']) if r.message.node == '/conductor'
    ]
    ended = ('recorder', 'game', 'planner')
    for node in ended:
        said = f'the node {node} ended ({KILLED}), and is started again'
        assert f'humanopts: {said}; its ' in command.errors
        assert said in conductor or node == 'recorder'  # which was away
        assert said in (tmp_path / f'out/log/{node}.log').read_text('utf-8')
        summed = f'the node {node} ended once ({KILLED}) and was restarted\n'
        assert f'humanopts demo: {summed}' in command.errors
    found = json.loads((tmp_path / 'out' / 'summary.json').read_text('utf-8'))
    assert [(e['node'], e['how']) for e in found['ended_nodes']] == [(n, KILLED) for n in ended]
    assert (found['execution']['episodes'], found['bag']['path']) == (EPISODES, 'bag-2')
    assert found['offline']['options'] == found['options']
    for option in found['options']:
        assert (option['method'], option['policy_accuracy']) == (GOAL, 1.0)
        assert option['n_demonstrations'] <= 6

    # The first bag holds what was shown first, and the second one everything.
    assert f'the recording is in several bags, with gaps between them: {first.path}' in (
        command.errors
    )
    assert re.search('not closed|cut short', first.damage)
    assert (second.damage, second.facts['continues']) == ('', 'bag')
    shown = shown_on_disk(tmp_path / 'out')
    assert len({demo.uuid for demo in shown}) == len(shown)
    in_first = shown_in_bag(first)
    assert in_first[: len(before)] == before
    assert in_first == shown[: len(in_first)]
    assert {demo.uuid: demo for demo in shown_in_bag(second)} == {d.uuid: d for d in shown}
    *_, last = second.messages(['/lesson_state'])
    assert last.message.paused == ''


@slow
def test_a_node_that_cannot_go_on_is_given_up(start: Start, tmp_path: Path) -> None:
    command = start()
    teach(command, tmp_path)
    shutil.rmtree(tmp_path / 'out' / 'options')
    (tmp_path / 'out' / 'options').write_text('')
    command.kill('learner', SIGKILL)
    assert command.ended(PATIENCE) == 1
    (last,) = [s for s in command.errors.splitlines() if s.startswith('humanopts demo: ')]
    assert all(words in last for words in ('the node learner ended', 'while it was needed'))
    assert 'options' in command.errors
    assert 'Traceback' not in command.errors
    command.gone(2.0)


@pytest.mark.parametrize('how', [SIGINT, pytest.param(SIGTERM, marks=slow)])
def test_a_demo_whose_status_is_asked_for_and_that_is_interrupted_stops_everything(
    start: Start,
    tmp_path: Path,
    domain_id: int,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    how: signal.Signals,
) -> None:
    def look() -> tuple[int, dict[str, Any]]:
        status = main(['status', '--json'])
        return status, json.loads(capsys.readouterr().out)

    def look_until(*well: int, planner_restarts: int) -> dict[str, Any]:
        # On a busy machine an answer may be late, which is reported as a fault, or a status.
        looks: list[dict[str, Any]] = []

        def seen() -> bool:
            status, found = look()
            looks.append(found)
            (planner,) = [node for node in found['nodes'] if node['name'] == 'planner']
            restarted = (planner['state'], planner['restarts']) == ('ready', planner_restarts)
            return status in well and restarted

        command.until(seen, f'the exit status {well} and {planner_restarts} restarts')
        return looks[-1]

    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain_id))
    assert look()[0] == 2
    command = start('--step-period', 0.1, '--budget', 8, '--episodes', 100)
    teach(command, tmp_path)
    found = look_until(0, planner_restarts=0)
    nodes = {node['name']: node for node in found['nodes']}
    assert list(nodes) == NODES
    assert [name for name in NODES if nodes[name]['answer'] is None] == ['conductor']
    assert {nodes[name]['state'] for name in NODES} == {'ready'}
    assert all(nodes[name]['pid'] in command.running() for name in NODES[1:])
    assert (found['recorder']['missing'], found['game']) == (0, 'taxi')

    command.kill('planner', SIGKILL)
    command.until(lambda: 'is started again' in command.errors, 'its restart')
    look_until(0, 1, planner_restarts=1)  # a node that is stopped for long ends
    command.kill('simulated_teacher', SIGSTOP)
    found = look_until(1, planner_restarts=1)
    nodes = {node['name']: node for node in found['nodes']}
    pid = nodes['simulated_teacher']['pid']
    stopped = f'simulated_teacher is stopped; kill -CONT {pid} resumes it'
    assert stopped in found['faults']
    command.until(lambda: f'the node {stopped}' in command.errors, 'its name')
    command.kill('simulated_teacher', SIGCONT)

    command.send(how)
    command.send(how)  # an impatient second one changes nothing
    assert command.ended(PATIENCE) == 130
    lines = [line for line in command.errors.splitlines() if not line.startswith('  ')]  # logs
    said = [line for line in lines if ': the node ' not in line]
    assert said == ['humanopts demo: interrupted; everything is stopped']
    command.gone(2.0)
    bag = bag_of(tmp_path)
    assert bag.damage == ''
    assert shown_in_bag(bag) == shown_on_disk(tmp_path / 'out')
