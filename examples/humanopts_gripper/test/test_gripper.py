"""The mechanics of the gripper, checked by hand-made cases."""

from humanopts_gripper.simulation import BIN, Gripper, MOTIONS, RAIL, STRIDE
import pytest


def do(gripper: Gripper, *motions: str) -> None:
    for motion in motions:
        gripper.begin(motion)
        for _ in range(100):
            gripper.step(0.02)
        assert not gripper.is_moving()


@pytest.fixture
def gripper() -> Gripper:
    """A gripper above its object."""
    gripper = Gripper()
    gripper.object = gripper.joints['slider']
    return gripper


def test_it_carries_the_object_into_the_bin(gripper: Gripper) -> None:
    do(gripper, 'lower', 'close', 'raise')
    assert gripper.holding
    while abs(gripper.joints['slider'] - BIN[0]) > STRIDE / 2:
        do(gripper, 'right')
    assert gripper.object == gripper.joints['slider']
    assert not gripper.is_in_bin()
    do(gripper, 'lower', 'open')
    assert gripper.is_in_bin()


@pytest.mark.parametrize('motions', [('close',), ('lower', 'open'), ('close', 'lower')])
def test_it_holds_nothing_without_closing_around_it(
    gripper: Gripper, motions: tuple[str, ...]
) -> None:
    do(gripper, *motions)
    assert not gripper.holding


def test_it_does_not_grasp_beside_the_object(gripper: Gripper) -> None:
    do(gripper, 'left', 'lower', 'close')
    assert not gripper.holding


def test_it_does_not_travel_while_lowered_and_not_beyond_the_rail(gripper: Gripper) -> None:
    do(gripper, 'lower')
    with pytest.raises(ValueError, match='raise the gripper'):
        gripper.begin('left')
    do(gripper, 'raise', *['right'] * 9)
    assert gripper.joints['slider'] == RAIL


def test_a_motion_takes_time_and_can_be_stopped(gripper: Gripper) -> None:
    gripper.begin('lower')
    gripper.step(0.1)
    assert gripper.joints['lift'] == pytest.approx(0.05)
    gripper.stop()
    gripper.step(1.0)
    assert gripper.joints['lift'] == pytest.approx(0.05)
    with pytest.raises(KeyError):
        gripper.begin('jump')


def test_a_seed_gives_the_same_motions_and_places() -> None:
    first, second, other = Gripper(1), Gripper(1), Gripper(2)
    for each in (first, second, other):
        do(each, 'left', 'right')
        each.put_object()
    assert (first.joints, first.object) == (second.joints, second.object)
    assert first.object != other.object
    assert len(MOTIONS) == 6
