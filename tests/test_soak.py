"""A lesson goes on among random faults: the short form of ``make soak``."""

import math
from pathlib import Path
import random

from graph_support.garbage import Garbage
from graph_support.soak import run
from humanopts_interfaces.msg import Demonstration, GameState, LessonState
from humanopts_interfaces.srv import EndDemonstration
import pytest
from rclpy.serialization import deserialize_message, serialize_message

KINDS = ('kill', 'stop', 'terminal', 'clock', 'files', 'messages')
SEED = 1


@pytest.mark.timeout(300)
def test_nothing_is_lost_or_done_twice_among_random_faults(
    tmp_path: Path,
    domain_id: int,
    monkeypatch: pytest.MonkeyPatch,
    short_lease: None,
) -> None:
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain_id))
    outcome, report = run(*(tmp_path, math.inf, SEED, KINDS, len(KINDS)), messages=100, settle=0.1)
    print(report)
    assert outcome.violations == []
    assert len(outcome.recoveries) == len(KINDS)
    assert outcome.messages == 100


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
