"""A lesson goes on among random faults: the short form of ``make soak``."""

from pathlib import Path
import random

from graph_support.garbage import Garbage
from graph_support.soak import GARBAGE, KINDS, run
from humanopts_interfaces.msg import Demonstration, GameState, LessonState
from humanopts_interfaces.srv import EndDemonstration
import pytest
from rclpy.serialization import deserialize_message, serialize_message

SECONDS = 20.0  # of faults; the launch and its end come on top


@pytest.mark.timeout(150)
@pytest.mark.parametrize('kinds', [(*KINDS, *GARBAGE)])
def test_nothing_is_lost_or_done_twice_among_random_faults(
    tmp_path: Path, domain_id: int, monkeypatch: pytest.MonkeyPatch, kinds: tuple[str, ...]
) -> None:
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain_id))
    outcome, lines = run(tmp_path, SECONDS, 4, kinds, 12, messages=100, calls=10)
    print('\n'.join(lines))
    assert outcome.violations == []
    assert sum(map(len, outcome.seconds.values())) >= 1  # how many depends on the machine


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
