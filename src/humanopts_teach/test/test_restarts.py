"""When a node that ended is started again: sooner the first time, and not for ever."""

from humanopts_teach.launching.restarts import NodeExit, RestartPolicy, STEADY
import pytest

KILLED = -9


def pauses(policy: RestartPolicy, ran: float, count: int) -> list[float | None]:
    """Return the pauses before each life of a node whose policy are so long, s."""
    now, found = 100.0, []
    for _ in range(count):
        policy.begin(now)
        now += ran
        due = policy.end(now, KILLED)
        found.append(None if due is None else round(due - now, 6))
        now = due or now
    return found


def test_pauses_double_until_it_is_given_up() -> None:
    assert pauses(RestartPolicy(4), 1.0, 5) == [0.1, 0.2, 0.4, 0.8, None]
    assert pauses(RestartPolicy(0), 1.0, 1) == [None]


def test_a_node_that_ran_long_enough_is_started_again_for_ever() -> None:
    assert pauses(RestartPolicy(2), STEADY + 1.0, 50) == [0.1] * 50


def test_a_node_that_cannot_start_is_not_started_again() -> None:
    policy = RestartPolicy(5)
    policy.begin(0.0)
    assert policy.end(100.0, 2) is None


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
    assert NodeExit('game', 'exit status 1', '', restarts, again).sentence == said
