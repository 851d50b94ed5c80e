"""A process of a graph over several machines joins it once it has an address for the others."""

from collections.abc import Iterator
from itertools import chain, repeat
import os
import socket
from types import SimpleNamespace

from humanopts_ros import environment
from humanopts_ros.environment import PEERS, prepare_discovery, PROFILES, RANGE
import psutil
import pytest

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
