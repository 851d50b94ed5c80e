"""When a node that ended is started again: sooner the first time, and not for ever."""

from humanopts_teach.launching.restarts import Ended, Lives, STEADY
import pytest

KILLED = -9


def pauses(lives: Lives, ran: float, count: int) -> list[float | None]:
    """Return the pauses before each life of a node whose lives are so long, s."""
    now, found = 100.0, []
    for _ in range(count):
        lives.begin(now)
        now += ran
        due = lives.end(now, KILLED)
        found.append(None if due is None else round(due - now, 6))
        now = due or now
    return found


def test_pauses_double_until_it_is_given_up() -> None:
    assert pauses(Lives(4), 1.0, 5) == [0.1, 0.2, 0.4, 0.8, None]
    assert pauses(Lives(0), 1.0, 1) == [None]


def test_a_node_that_ran_long_enough_is_started_again_for_ever() -> None:
    assert pauses(Lives(2), STEADY + 1.0, 50) == [0.1] * 50


def test_a_node_that_cannot_start_is_not_started_again() -> None:
    lives = Lives(5)
    lives.begin(0.0)
    assert lives.end(100.0, 2) is None


@pytest.mark.parametrize(
    ('restarts', 'again', 'said'),
    [
        (1, True, 'the node game ended (exit status 1), and is started again'),
        (0, False, 'the node game ended (exit status 1) while it was needed'),
        (5, False, 'the node game ended (exit status 1) after 5 restarts in a row while it was '
         'needed'),
    ],
)  # fmt: skip
def test_an_end_is_told_in_words(restarts: int, again: bool, said: str) -> None:
    assert Ended('game', 'exit status 1', '', restarts, again).sentence == said
