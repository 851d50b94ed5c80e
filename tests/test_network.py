"""A graph on one machine can be reached from no other; one over several waits for an address."""

from collections.abc import Iterator
from itertools import chain, repeat
import os
from pathlib import Path
import socket
from types import SimpleNamespace

from graph_support.live import GAME, Graph, LEARNER
from humanopts_ros import environment
from humanopts_ros.environment import PEERS, prepare_discovery, PROFILES, RANGE
import psutil
import pytest


def test_every_socket_of_a_node_is_bound_to_the_loopback_interface(
    live: Graph, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(PROFILES[0])
    monkeypatch.setenv(RANGE, 'LOCALHOST')
    nodes = live.spawn(GAME), live.spawn(LEARNER, directory=tmp_path)
    live.ready('/game', '/learner')
    for node in nodes:
        bound = {
            c.laddr.ip for c in psutil.Process(node.process.pid).net_connections('udp') if c.laddr
        }
        assert bound == {'127.0.0.1'}


@pytest.mark.parametrize(
    ('given', 'profile', 'kept'),
    [
        ({RANGE: 'LOCALHOST'}, 'loopback_discovery.xml', 'SYSTEM_DEFAULT'),
        ({RANGE: 'LOCALHOST', PEERS: '10.0.0.2'}, 'quick_discovery.xml', 'LOCALHOST'),
        ({RANGE: 'SUBNET'}, 'quick_discovery.xml', 'SUBNET'),
        ({}, 'quick_discovery.xml', None),
        ({RANGE: 'LOCALHOST', PROFILES[1]: 'own.xml'}, None, 'LOCALHOST'),
    ],
)
def test_the_profile_follows_from_the_range(
    monkeypatch: pytest.MonkeyPatch,
    given: dict[str, str],
    profile: str | None,
    kept: str | None,
) -> None:
    for name in (*PROFILES, RANGE, PEERS):
        monkeypatch.delenv(name, raising=False)
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(environment, '_await_network', lambda: None)
    prepare_discovery()
    found = os.environ.get(PROFILES[0])
    assert (Path(found).name if found else None, os.environ.get(RANGE)) == (profile, kept)
    monkeypatch.setenv(PROFILES[0], 'restored')  # so that the test leaves nothing behind
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

    address = environment._address_towards(OTHER)
    entry = SimpleNamespace(family=socket.AF_INET, address=address)
    monkeypatch.setattr(psutil, 'net_if_stats', stats)
    monkeypatch.setattr(psutil, 'net_if_addrs', lambda: {'cable:1': [entry]})
    kept = {name: os.environ.pop(name, None) for name in (*PROFILES, RANGE, PEERS)}
    yield looks
    for name, value in kept.items():
        os.environ.pop(name, None)
        if value is not None:
            os.environ[name] = value


def test_it_waits_for_the_carrier_of_the_cable_to_the_other_machine(cable: list[bool]) -> None:
    os.environ.update(AWAY)
    prepare_discovery()
    assert cable == [False, False, False, True]


def test_where_no_network_comes_up_it_says_so_and_goes_on(
    cable: list[bool], monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(environment, '_NETWORK_WAIT', 0.0)
    os.environ.update(AWAY)
    prepare_discovery()
    assert f'no network is up towards {OTHER}:' in capfd.readouterr().err
    assert PROFILES[0] in os.environ


def test_a_loopback_address_is_no_network_of_others(
    cable: list[bool], monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(environment, '_NETWORK_WAIT', 0.3)
    os.environ[RANGE] = 'SUBNET'
    prepare_discovery()
    assert 'no network is up towards other machines:' in capfd.readouterr().err


@pytest.mark.parametrize('chosen', ['LOCALHOST', 'OFF'])
def test_a_graph_on_one_machine_needs_no_network(cable: list[bool], chosen: str) -> None:
    os.environ[RANGE] = chosen
    prepare_discovery()
    assert not cable
