"""Arrival times of messages while the time of day is changed."""

from dataclasses import dataclass
from itertools import count

from humanopts_ros.workarounds import TimeOfDay
from humanopts_teach.bags.arrival_times import ArrivalTimes
from hypothesis import given
from hypothesis import strategies as st
import pytest

S, MS = 10**9, 10**6
BEGUN = 1_700_000_000 * S  # the time of day


@dataclass
class Clocks:
    """Clocks of a machine whose time of day is changed."""

    elapsed: int = 5 * S
    day: int = BEGUN - 5 * S

    def time_of_day(self) -> int:
        return self.day + self.elapsed

    def steady(self) -> int:
        return self.elapsed


SETTINGS = st.one_of(
    st.just(0), st.integers(2 * MS, 7200 * S), st.integers(2 * MS, 7200 * S).map(lambda ns: -ns)
)


@given(st.lists(st.tuples(SETTINGS, st.integers(1, 20 * MS), st.integers(1, 20 * MS)), max_size=8))
def test_times_go_on_from_the_time_of_day_at_the_start(looks: list[tuple[int, int, int]]) -> None:
    clocks = Clocks()
    times = ArrivalTimes(TimeOfDay(clocks.time_of_day, clocks.steady))
    last = 0
    for setting, before, after in looks:
        clocks.elapsed += before
        first = clocks.time_of_day(), clocks.elapsed
        clocks.day += setting
        clocks.elapsed += after
        second = clocks.time_of_day(), clocks.elapsed
        times.check()
        assert times.now == BEGUN - 5 * S + clocks.elapsed
        found = [times.of('/a', received) for received, _ in (first, second)]
        assert last <= found[0] <= found[1] <= times.now
        last = found[1]
        if setting == 0 or abs(setting) > before + after:
            assert found == [BEGUN - 5 * S + elapsed for _, elapsed in (first, second)]


@pytest.mark.parametrize('setting', [0, -3600 * S, S])
def test_a_pause_while_clocks_are_read_is_not_taken_for_a_setting(setting: int) -> None:
    clocks, readings = Clocks(), count()

    def time_of_day() -> int:
        read = clocks.time_of_day()
        clocks.elapsed += 0 if next(readings) % 5 == 3 else 20 * MS
        return read

    times = TimeOfDay(time_of_day, clocks.steady)
    looks = [times.check(), times.check()]
    clocks.day += setting
    assert [*looks, times.check(), times.check()] == [0, 0, setting, 0]


@pytest.mark.parametrize('setting', [0, 3600 * S])
def test_what_was_left_from_an_earlier_look_keeps_its_time_or_gets_that_of_the_last_look(
    setting: int,
) -> None:
    clocks = Clocks()
    times = ArrivalTimes(TimeOfDay(clocks.time_of_day, clocks.steady))
    received = clocks.time_of_day()
    clocks.day += setting
    looks = [received]
    for _ in range(2):
        clocks.elapsed += S
        times.check()
        looks.append(times.now)
    assert times.of('/a', received) == looks[1 if setting else 0]
