"""
One lesson over two hosts whose cable is pulled in the middle, or plugged in late.

``make test-hosts`` runs it; ``make test`` leaves it out, since it needs namespaces of networks.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
import json
from pathlib import Path
import subprocess
import time
from typing import Any

from graph_support.hosts import end, Host, pulled, two_hosts
from graph_support.soak import on_disk
from humanopts_teach.bags.check import check_bag
from humanopts_teach.bags.reader import Bag, open_bag
import pytest
import yaml

pytestmark = [pytest.mark.hosts, pytest.mark.live, pytest.mark.timeout(600)]

OPTION = 'go to passenger and pickup'
BUDGET = 14  # demonstrations and "not here" answers; fewer than the criteria need
PULLED_AT = 4  # kept demonstrations
LATE = 5.0  # s after the launch of a host that its network is up; it waits for twice that
LEASE = 20.0  # s without a sign after which Fast DDS forgets the nodes of the other host
HERE, THERE = 'game,lesson,recorder', 'learner,option_server,planner'


@pytest.fixture
def hosts(tmp_path: Path) -> Iterator[tuple[Host, Host]]:
    try:
        with two_hosts(tmp_path) as both:
            yield both
    except OSError as error:
        pytest.fail(str(error))


@contextmanager
def running(process: 'subprocess.Popen[bytes]') -> Iterator['subprocess.Popen[bytes]']:
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()


def found(host: Host, peers: bool) -> dict[str, str]:
    """Return the variables by which the nodes of the hosts find each other."""
    if peers:
        return {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', 'ROS_STATIC_PEERS': host.peer}
    return {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET'}


def up(host: Host, nodes: str, peers: bool) -> 'subprocess.Popen[bytes]':
    words = ['up', 'taxi', '--only', nodes, '--out', str(host.folder / 'out')]
    words += ['--budget', str(BUDGET)]
    command = ['-m', 'humanopts_teach', *words]
    return host.start(command, host.folder / 'up.log', **found(host, peers))


def teacher(host: Host, peers: bool) -> 'subprocess.Popen[bytes]':
    file = host.folder / 'teacher.yaml'
    values = {'options': [OPTION], 'expect_recorder': True}
    file.write_text(yaml.safe_dump({'/**': {'ros__parameters': values}}))
    command = ['-m', 'humanopts_teach.ros.simulated_teacher', '--ros-args', '--params-file']
    return host.start([*command, str(file)], host.folder / 'teacher.log', **found(host, peers))


def until(condition: Callable[[], bool], what: str, seconds: float, *logs: Path) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        said = '\n'.join(f'{log}:\n{log.read_text(errors="replace")[-2000:]}' for log in logs)
        assert time.monotonic() < deadline, f'timed out waiting for {what}\n{said}'
        time.sleep(0.1)


def is_ready(log: Path) -> bool:
    """Return whether all nodes of a launch are ready; a launch that gave up says "not ready:"."""
    return any(line.startswith('ready: ') for line in log.read_text('utf-8').splitlines())


def kept(host: Host) -> set[str]:
    """Return the demonstrations of the lesson's journal."""
    return {demo.uuid for demo in on_disk(host.folder / 'out' / 'demonstrations')}


def learned(host: Host) -> list[str]:
    """Return the demonstration of each line that the learner has written down."""
    files = sorted((host.folder / 'out' / 'options').glob('*.jsonl'))
    lines = [line for file in files for line in file.read_text('utf-8').splitlines(keepends=True)]
    return [json.loads(line)['uuid'] for line in lines if line.endswith('\n')]


def values(bag: Bag, topic: str) -> list[Any]:
    return [recorded.message for recorded in bag.messages([topic])]


@pytest.mark.parametrize(
    ('peers', 'seconds', 'taught_from'),
    [(True, 10.0, 0), (False, 10.0, 0), (True, 10.0, 1), (True, 30.0, 0)],
    ids=['static peers', 'subnet', 'teacher on the other side', 'so long that they forget'],
)
def test_nothing_is_lost_or_done_twice_when_the_cable_is_pulled(
    hosts: tuple[Host, Host], peers: bool, seconds: float, taught_from: int
) -> None:
    a, b = hosts
    logs = [host.folder / 'up.log' for host in hosts]
    with running(up(a, HERE, peers)) as first, running(up(b, THERE, peers)) as second:
        until(lambda: all(map(is_ready, logs)), 'nodes', 90.0, *logs)
        with running(teacher(hosts[taught_from], peers)) as taught:
            logs.append(hosts[taught_from].folder / 'teacher.log')
            until(lambda: len(kept(a)) >= PULLED_AT, 'the first demonstrations', 150.0, *logs)
            with pulled(a):
                time.sleep(seconds)
            until(lambda: len(kept(a)) == BUDGET, 'the end of the lesson', 150.0, *logs)
            until(lambda: set(learned(b)) == kept(a), 'the learner', 60.0, *logs)
            assert end(taught) == 0
        assert end(second) == 0, logs[1].read_text()
        assert end(first) == 0, logs[0].read_text()

    (folder,) = (a.folder / 'out' / 'bags').iterdir()
    bag = open_bag(folder)
    checked = check_bag(bag)
    assert not checked.damage
    lossy = {
        stream.publisher.partition('#')[0][1:] for stream in checked.streams if stream.missing
    }
    assert lossy <= (set(THERE.split(',')) if seconds > LEASE else set())
    shown = [demo.uuid for demo in values(bag, '/demonstrations')]
    assert set(shown) == kept(a)
    assert sorted(learned(b)) == sorted(kept(a))
    (status,) = values(bag, '/learning_status')[-1].options
    assert status.n_demonstrations + status.n_not_here == BUDGET
    states = values(bag, '/game_state')
    steps = Counter((s.action_publisher_id, s.action_sequence) for s in states if s.step)
    assert steps.most_common(1)[0][1] == 1
    sent = {(c.publisher_id, c.sequence) for c in values(bag, '/action')}
    refused = {
        (r.command_publisher_id, r.command_sequence) for r in values(bag, '/action_refused')
    }
    assert set(steps) == sent - refused


@pytest.mark.parametrize('peers', [True, False], ids=['static peers', 'subnet'])
def test_a_host_whose_network_is_up_after_its_launch_began_is_found(
    hosts: tuple[Host, Host], peers: bool
) -> None:
    a, b = hosts
    logs = [host.folder / 'up.log' for host in hosts]
    with pulled(a):
        began = up(b, THERE, peers)
        time.sleep(LATE)
    with running(began) as second, running(up(a, HERE, peers)) as first:
        until(lambda: all(map(is_ready, logs)), 'nodes', 90.0, *logs)
        assert end(second) == 0, logs[1].read_text()
        assert end(first) == 0, logs[0].read_text()
