"""The physics of the rover, checked by hand-made cases."""

import math

from humanopts_rover.simulation import (
    BEAMS,
    HEIGHT,
    MAX_LINEAR,
    PLACES,
    RADIUS,
    Simulation,
    turn,
    WIDTH,
)
import pytest


@pytest.fixture
def rover() -> Simulation:
    return Simulation(noise=False)


def test_it_accelerates_drives_straight_and_stops_within_a_fifth_of_a_second(
    rover: Simulation,
) -> None:
    rover.place(2.0, 3.5, 0.0)
    rover.step(0.3, 0.0, 1.0)
    assert rover.linear == 0.3
    assert rover.pose == pytest.approx((2.0 + 0.3 * 0.95, 3.5, 0.0), abs=0.01)
    rover.step(MAX_LINEAR, 0.0, 1.0)
    rover.step(0.0, 0.0, 0.2)
    assert rover.linear == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(('commanded', 'reached'), [(9.0, 0.6), (-9.0, -0.6)])
def test_its_speed_is_limited(rover: Simulation, commanded: float, reached: float) -> None:
    rover.step(commanded, 0.0, 0.3)
    assert rover.linear == reached


def test_turning_counterclockwise_is_positive(rover: Simulation) -> None:
    rover.place(2.0, 3.5, 0.0)
    rover.step(0.0, 1.0, 1.0)
    assert (rover.pose.x, rover.pose.y) == (2.0, 3.5)
    assert 0.9 < rover.pose.yaw < 1.0


def test_a_wall_stops_it_and_it_can_back_off(rover: Simulation) -> None:
    rover.place(0.6, 3.0, math.pi)
    for _ in range(20):
        rover.step(0.6, 0.0, 0.2)
    assert rover.bumped
    assert RADIUS <= rover.pose.x < RADIUS + 0.05
    rover.step(-0.3, 0.0, 1.0)
    assert not rover.bumped
    assert rover.pose.x > 0.35


def test_the_scan_measures_walls_around_it(rover: Simulation) -> None:
    rover.place(3.0, 4.4, 0.0)
    ahead, left, behind = BEAMS // 2, BEAMS * 3 // 4, 0
    assert rover.scan()[[ahead, left, behind]] == pytest.approx([1.0, 0.6, 3.0])
    rover.set_door('side_door', True)
    assert rover.scan()[ahead] == pytest.approx(WIDTH - 3.0)


def test_the_path_leads_through_open_doors_only(rover: Simulation) -> None:
    rover.place(2.0, 3.5, 0.0)
    first, *_, last = through_door = rover.path('charger')
    assert (first, last) == ((2.0, 3.5), PLACES['charger'][:2])
    rover.set_door('side_door', True)
    rover.set_door('door', False)
    detour = rover.path('charger')
    assert any(y > 4.1 for _, y in detour)
    assert not any(y > 4.1 for _, y in through_door)
    rover.set_door('side_door', False)
    assert rover.path('charger') == []
    with pytest.raises(KeyError):
        rover.path('cellar')


@pytest.mark.parametrize('seed', range(5))
@pytest.mark.parametrize('place', PLACES)
def test_who_follows_the_path_arrives_from_anywhere(seed: int, place: str) -> None:
    rover = Simulation(seed)
    rover.place_randomly()
    for _ in range(400):
        way = rover.path(place)
        if math.dist(way[0], way[-1]) < 0.15:
            return
        x, y, yaw = rover.pose
        off = turn(math.atan2(way[1][1] - y, way[1][0] - x) - yaw)
        rover.step(0.3 * (abs(off) < 0.3), math.copysign(0.8, off) * (abs(off) > 0.1), 0.2)
    pytest.fail(f'{place} was not reached: {rover.pose}, {rover.path(place)}')


def test_doors_do_not_close_on_the_rover(rover: Simulation) -> None:
    rover.place(4.0, 2.5, 0.0)
    with pytest.raises(ValueError, match='in the way of door'):
        rover.set_door('door', False)
    assert rover.doors['door']
    with pytest.raises(KeyError):
        rover.set_door('gate', True)


@pytest.mark.parametrize('at', [(0.1, 1.0), (1.9, 1.8), (-1.0, 1.0), (4.0, 1.0), (math.nan, 1.0)])
def test_it_cannot_be_carried_into_a_wall(rover: Simulation, at: tuple[float, float]) -> None:
    before = rover.pose
    with pytest.raises(ValueError, match='no room'):
        rover.place(*at, 0.0)
    assert rover.pose == before


def test_it_is_carried_to_every_part_of_a_room(rover: Simulation) -> None:
    poses = []
    for _ in range(300):
        rover.place_randomly('east')
        poses.append(rover.pose)
    xs, ys = [p.x for p in poses], [p.y for p in poses]
    assert 4.0 < min(xs) < 4.6
    assert WIDTH - 0.6 < max(xs) < WIDTH
    assert min(ys) < 0.6
    assert max(ys) > HEIGHT - 0.6


def test_the_battery_drains_by_driving_and_is_charged_at_the_charger(rover: Simulation) -> None:
    rover.step(0.3, 0.0, 1.0)
    drained = rover.battery
    assert 0.99 < drained < 1.0
    rover.place(*PLACES['charger'])
    assert rover.is_charging()
    rover.step(0.0, 0.0, 1.0)
    assert rover.battery == 1.0
    rover.battery = 0.0
    rover.place(2.0, 3.5, 0.0)
    rover.step(0.3, 0.0, 1.0)
    assert rover.pose.x == 2.0


def test_a_seed_gives_the_same_drive_and_noise_and_another_seed_does_not() -> None:
    def drive(seed: int) -> list[float]:
        rover = Simulation(seed)
        rover.place_randomly()
        rover.step(0.3, 0.2, 1.0)
        return [*rover.pose, *rover.scan(), rover.odometry().x]

    assert drive(1) == drive(1)
    assert drive(1) != drive(2)
