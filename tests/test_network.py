"""A graph that is to stay on this machine can be reached from no other."""

import os
from pathlib import Path

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
