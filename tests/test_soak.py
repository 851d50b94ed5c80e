"""A lesson goes on among random faults: the short form of ``make soak``."""

import math
from pathlib import Path
import random

from graph_support.garbage import Garbage
from graph_support.soak import GARBAGE, KINDS, run
from humanopts_interfaces.msg import Demonstration, GameState, LessonState
from humanopts_interfaces.srv import EndDemonstration
import pytest
from rclpy.serialization import deserialize_message, serialize_message

FAULTS = 3
SEED = 126  # with which a node is killed, one is stopped, and garbage is sent


@pytest.mark.timeout(300)
def test_nothing_is_lost_or_done_twice_among_random_faults(
    tmp_path: Path, domain_id: int, monkeypatch: pytest.MonkeyPatch, short_lease: None
) -> None:
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain_id))
    kinds = (*KINDS, *GARBAGE)
    outcome, lines = run(
        *(tmp_path, math.inf, SEED, kinds, FAULTS), messages=100, calls=10, settle=0.1
    )
    print('\n'.join(lines))
    assert outcome.violations == []
    done = [name for name, times in outcome.seconds.items() for _ in times]
    assert len(done) == FAULTS
    assert {name.split()[0] for name in done} == {'kill', 'stop', 'garbage'}


@pytest.mark.parametrize('kind', [GameState, LessonState, Demonstration, EndDemonstration.Request])
def test_garbage_is_that_of_its_seed_and_can_be_sent(kind: type) -> None:
    def make() -> list[object]:
        garbage = Garbage(random.Random(5))
        return [garbage.message(kind) for _ in range(50)]

    made = make()
    assert list(map(str, make())) == list(map(str, made))
    assert len(set(map(str, made))) > 25
    for message in made:
        deserialize_message(serialize_message(message), kind)
