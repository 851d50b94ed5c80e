"""
A graph on one machine can be reached from no other; one over several waits for an address. The
memory of messages is given back.
"""

from collections.abc import Iterator, Sequence
from importlib.resources import files
from itertools import chain, repeat
import os
from pathlib import Path
import socket
import subprocess
import sys
from types import SimpleNamespace

from graph_support.live import GAME, Graph, LEARNER
from humanopts_ros import workarounds
from humanopts_ros.middleware import (
    address_towards,
    check_settings,
    MiddlewareError,
    PEERS,
    PROFILES,
    RANGE,
)
from humanopts_ros.workarounds import prepare_discovery, READ_PROFILES
import psutil
import pytest


def test_every_socket_of_a_node_is_bound_to_the_loopback_interface(
    live: Graph, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in PROFILES:
        monkeypatch.delenv(name)
    monkeypatch.setenv(RANGE, 'LOCALHOST')
    nodes = live.spawn(GAME), live.spawn(LEARNER, directory=tmp_path)
    live.ready('/game', '/learner')
    for node in nodes:
        bound = {
            c.laddr.ip for c in psutil.Process(node.process.pid).net_connections('udp') if c.laddr
        }
        assert bound == {'127.0.0.1'}


BURST = """
from humanopts_ros.workarounds import prepare_discovery
import psutil
prepare_discovery()
import rclpy
from rclpy.qos import QoSProfile
from std_msgs.msg import String

rclpy.init()
node, heard, depth = rclpy.create_node('burst'), [], QoSProfile(depth=100)
publisher = node.create_publisher(String, 'large', depth)
node.create_subscription(String, 'large', lambda message: heard.append(None), depth)
while not publisher.get_subscription_count():
    rclpy.spin_once(node, timeout_sec=0.1)
memory = psutil.Process().memory_info
before = memory().rss
for _ in range(100):
    publisher.publish(String(data='x' * 1_000_000))
while len(heard) < 100:
    rclpy.spin_once(node, timeout_sec=0.1)
print(memory().rss - before)
"""


@pytest.mark.parametrize('where', ['LOCALHOST', 'SUBNET'])
def test_a_burst_of_large_messages_leaves_no_memory_in_use(live: Graph, where: str) -> None:
    environment = {key: value for key, value in os.environ.items() if key not in PROFILES}
    kept = subprocess.run(
        [sys.executable, '-c', BURST],
        env={**environment, RANGE: where},
        stdout=subprocess.PIPE,
        check=True,
        timeout=60,
    )
    grown = int(kept.stdout.splitlines()[-1])  # the middleware may have said something before
    assert grown < 30e6, 'of 100 MB that were sent'


LOOPBACK = str(files('humanopts_ros') / 'loopback_discovery.xml')


QUICK, BOUND = 'quick_discovery.xml', ('loopback_discovery.xml', 'SYSTEM_DEFAULT')
LOCAL = {RANGE: 'LOCALHOST'}


@pytest.mark.parametrize(
    ('given', 'profile', 'kept'),
    [
        (LOCAL, *BOUND),
        ({**LOCAL, PEERS: '10.0.0.2'}, QUICK, 'LOCALHOST'),
        ({RANGE: 'SUBNET'}, QUICK, 'SUBNET'),
        ({}, QUICK, None),
        ({**LOCAL, PROFILES[1]: 'own.xml'}, None, 'LOCALHOST'),
        ({**LOCAL, 'ROS_DISTRO': 'kilted'}, QUICK, 'LOCALHOST'),
        ({**LOCAL, 'ROS_DISTRO': ''}, QUICK, 'LOCALHOST'),
        ({**LOCAL, 'RMW_IMPLEMENTATION': 'rmw_cyclonedds_cpp'}, QUICK, 'LOCALHOST'),
        ({**LOCAL, 'RMW_IMPLEMENTATION': 'rmw_fastrtps_cpp'}, *BOUND),
        ({RANGE: 'SUBNET', 'ROS_LOCALHOST_ONLY': '1'}, *BOUND),
        ({RANGE: 'SYSTEM_DEFAULT', PROFILES[0]: LOOPBACK}, *BOUND),
    ],
)
def test_the_profile_follows_from_the_range(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    given: dict[str, str],
    profile: str | None,
    kept: str | None,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'own.xml').write_text('<profiles/>')
    monkeypatch.setenv('ROS_DISTRO', 'jazzy')
    for name in (*PROFILES, READ_PROFILES, RANGE, PEERS):
        monkeypatch.delenv(name, raising=False)
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(workarounds, '_await_network', lambda: None)
    prepare_discovery()
    later = given.get('ROS_DISTRO') == 'kilted'  # it warns about the first name
    found = os.environ.get(PROFILES[later])
    assert os.environ.get(PROFILES[1]) == (found or given.get(PROFILES[1]))
    assert os.environ.get(PROFILES[0]) == (None if later else found)
    assert (Path(found).name if found else None, os.environ.get(RANGE)) == (profile, kept)
    assert os.environ.get(READ_PROFILES) == (profile and '1')
    for name in PROFILES:
        monkeypatch.setenv(name, 'restored')  # so that the test leaves nothing behind
    monkeypatch.setenv(READ_PROFILES, 'restored')
    monkeypatch.setenv(RANGE, 'restored')


OTHER = '127.0.0.9'  # a machine that any machine has a route to
AWAY = {RANGE: 'LOCALHOST', PEERS: f'{OTHER}; '}


@pytest.fixture
def cable(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[bool]]:
    """The one interface of a machine, which has had its address all along; each look at it."""
    looks: list[bool] = []
    carrier = chain([False] * 3, repeat(True))

    def stats() -> dict[str, SimpleNamespace]:
        looks.append(next(carrier))
        return {'cable': SimpleNamespace(isup=looks[-1])}

    address = address_towards(OTHER)
    entry = SimpleNamespace(family=socket.AF_INET, address=address)
    monkeypatch.setattr(psutil, 'net_if_stats', stats)
    monkeypatch.setattr(psutil, 'net_if_addrs', lambda: {'cable:1': [entry]})
    kept = {name: os.environ.pop(name, None) for name in (*PROFILES, READ_PROFILES, RANGE, PEERS)}
    yield looks
    for name, value in kept.items():
        os.environ.pop(name, None)
        if value is not None:
            os.environ[name] = value


def test_it_waits_for_the_carrier_of_the_cable_to_the_other_machine(cable: list[bool]) -> None:
    os.environ.update(AWAY)
    prepare_discovery()
    assert cable == [False, False, False, True]


@pytest.mark.parametrize(
    ('settings', 'whom'), [(AWAY, OTHER), ({RANGE: 'SUBNET'}, 'other machines')]
)
def test_where_no_network_comes_up_it_says_so_and_goes_on(
    cable: list[bool],
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    settings: dict[str, str],
    whom: str,
) -> None:
    monkeypatch.setattr(workarounds, '_NETWORK_WAIT', 0.3 if settings is not AWAY else 0.0)
    os.environ.update(settings)
    prepare_discovery()
    assert f'no network connection to {whom}:' in capfd.readouterr().err
    assert PROFILES[-1] in os.environ


def test_a_graph_on_one_machine_needs_no_network(cable: list[bool]) -> None:
    os.environ[RANGE] = 'LOCALHOST'
    prepare_discovery()
    assert not cable


FAULTS = [
    (RANGE, 'OFF', 'nodes cannot find each other'),
    (RANGE, 'localhost', 'choose from LOCALHOST, SUBNET'),
    (PEERS, '10.0.0.1 10.0.0.2', 'not a known machine'),
    (PEERS, '10.0.0.1;fe80::1', 'not an IPv4 address'),
    (PROFILES[0], '/nowhere.xml', 'which is not a file'),
    (PROFILES[0], 'text.xml', 'which is not XML'),
    (PROFILES[0], 'typo.xml', 'which Fast DDS cannot use'),
    (PROFILES[1], 'page.xml', 'which holds <html>'),
    ('ROS_DOMAIN_ID', '233', 'must be from 0 to 232'),
]
COMMANDS = (
    *(['humanopts_teach', *words] for words in (['status'], ['up', 'rooms'], ['demo'])),
    ['humanopts_teach', 'study', 'plan.yaml', '--simulate', '1'],
    ['humanopts_env.ros.game_node'],
)


@pytest.fixture
def shell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A shell without these variables, in a folder with the files that they name."""
    (tmp_path / 'text.xml').write_text('profiles')
    (tmp_path / 'page.xml').write_text('<html/>')
    typo = Path(LOOPBACK).read_text('utf-8').replace('receiveBufferSize', 'receiveBuffer')
    (tmp_path / 'typo.xml').write_text(typo)
    plan = 'study: s\nseed: 1\nall: {domain: rooms, teach: 1}\nconditions: [{name: a}]\n'
    (tmp_path / 'plan.yaml').write_text(plan)
    monkeypatch.chdir(tmp_path)
    for name in {name for name, *_ in FAULTS} | {READ_PROFILES, 'RMW_IMPLEMENTATION'}:
        monkeypatch.delenv(name, raising=False)
    return tmp_path


def refused(*command: str, before: Sequence[str] = ()) -> str:
    """Run what cannot start; return the one line that says why."""
    words = [*before, sys.executable, '-m', *command]
    done = subprocess.run(words, capture_output=True, text=True, timeout=30, check=False)
    assert (done.returncode, done.stdout, done.stderr.count('\n')) == (2, '', 1), done.stderr
    return done.stderr


@pytest.mark.parametrize(('name', 'value', 'words'), FAULTS)
def test_a_setting_with_which_ros_cannot_start_is_named(
    shell: Path, monkeypatch: pytest.MonkeyPatch, name: str, value: str, words: str
) -> None:
    monkeypatch.setenv(name, value)
    with pytest.raises(MiddlewareError, match=f'^{name} .*{words}'):
        check_settings(thorough=True)


@pytest.mark.parametrize('command', COMMANDS, ids=' '.join)
def test_what_needs_ros_refuses_it_in_one_line_before_anything_is_there(
    shell: Path, monkeypatch: pytest.MonkeyPatch, command: list[str]
) -> None:
    before = sorted(shell.iterdir())
    monkeypatch.setenv('RMW_IMPLEMENTATION', 'rmw_cyclonedds_cpp')
    assert "'rmw_cyclonedds_cpp', which is not installed; unset it, or" in refused(*command)
    assert sorted(shell.iterdir()) == before


def test_a_log_folder_that_cannot_be_made_is_refused_in_one_line(
    shell: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv('ROS_LOG_DIR', '/proc/none')
    assert 'ROS cannot start' in refused('humanopts_teach', 'status')


def test_commands_that_need_no_ros_do_not_mind(
    shell: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv('RMW_IMPLEMENTATION', 'rmw_cyclonedds_cpp')
    command = [sys.executable, '-m', 'humanopts_teach', 'study', 'status', 'plan.yaml']
    assert subprocess.run(command, check=False).returncode == 0


def test_a_machine_without_a_loopback_interface_is_told_so(
    shell: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    apart = ['unshare', '--map-root-user', '--net']
    if subprocess.run([*apart, 'true'], capture_output=True, check=False).returncode:
        pytest.skip('network namespaces cannot be made here')
    monkeypatch.setenv(RANGE, 'LOCALHOST')
    said = refused('humanopts_teach', 'status', before=apart)
    assert 'the loopback interface of this machine is down' in said
