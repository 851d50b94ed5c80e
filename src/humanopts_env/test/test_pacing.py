"""A paced game: which commands of machines wait, and which are answered at once."""

from dataclasses import replace

from humanopts_env.domains.taxi import Taxi
from humanopts_env.game import Accepted, Command, Game, Pacing, Reason, Refused, Result, Source
import pytest

FIRST = Command('planner-1', 1, Source.MACHINE, 1, 0, 'north')
SECOND = replace(FIRST, publisher_id='planner-2', action='south')
KEY = Command('anna-1', 1, Source.PERSON, 0, 0, 'west')


@pytest.fixture
def game() -> Game:
    """Return a game in the first state of episode 1."""
    game = Game(Taxi())
    game.reset('taxi 2,3 passenger R destination B', 3, Source.MACHINE)
    return game


@pytest.fixture
def pacing(game: Game) -> Pacing:
    """Return a pace in which one command waits."""
    pacing = Pacing(game, 0.3)
    assert pacing.offer(FIRST) == []
    assert pacing.waiting is FIRST
    return pacing


def reasons(results: list[Result]) -> list[tuple[Command, Reason]]:
    """Return what was refused and why, all of the results."""
    refused = [result for result in results if isinstance(result, Refused)]
    assert refused == results
    return [(refusal.command, refusal.reason) for refusal in refused]


def test_a_command_waits_and_is_carried_out_when_it_is_due(game: Game, pacing: Pacing) -> None:
    assert game.transition.step == 0
    (result,) = pacing.due()
    assert isinstance(result, Accepted)
    assert result.transition.previous_action == 'north'
    assert pacing.due() == []
    assert game.transition.step == 1


def test_another_command_for_the_same_step_is_refused_as_stale(game: Game, pacing: Pacing) -> None:
    (refusal,) = pacing.offer(SECOND)
    assert reasons([refusal]) == [(SECOND, Reason.STALE)]
    assert "'north' waits" in refusal.detail
    assert game.transition.step == 0
    assert pacing.waiting is FIRST


def test_what_is_refused_in_any_case_does_not_wait(game: Game) -> None:
    pacing = Pacing(game, 0.3)
    wrong = replace(FIRST, action='fly')
    assert reasons(pacing.offer(wrong)) == [(wrong, Reason.NO_SUCH_ACTION)]
    assert pacing.waiting is None


def test_a_key_is_not_delayed_and_overtakes_what_waits(game: Game, pacing: Pacing) -> None:
    (result,) = pacing.offer(KEY)
    assert isinstance(result, Accepted)
    assert game.transition.previous_action == 'west'
    assert reasons(pacing.due()) == [(FIRST, Reason.HELD_BY_PERSON)]


def test_after_a_reset_a_new_command_takes_the_place_of_the_old(
    game: Game, pacing: Pacing
) -> None:
    game.reset('', 4, Source.MACHINE)
    new = replace(FIRST, episode=2)
    assert reasons(pacing.offer(new)) == [(FIRST, Reason.STALE)]
    assert pacing.waiting is new
    (result,) = pacing.due()
    assert isinstance(result, Accepted)


@pytest.mark.parametrize('period', [0.0, 0.3])
def test_while_it_is_paused_only_the_steps_that_are_let_through_are_taken(
    game: Game, period: float
) -> None:
    pacing = Pacing(game)
    assert pacing.set_pace(period, 'anna-1') == []
    assert pacing.offer(FIRST) == pacing.due() == []
    (taken,) = pacing.set_pace(period, 'anna-1', steps=2)
    assert isinstance(taken, Accepted)
    (second,) = pacing.offer(replace(FIRST, step=1))  # the second step was let through before
    assert isinstance(second, Accepted)
    third = replace(FIRST, step=2)
    assert pacing.offer(third) == pacing.due() == []
    (result,) = pacing.set_pace(period, '')
    assert isinstance(result, Accepted)
    assert game.transition.step == 3


def test_steps_that_were_let_through_and_not_taken_are_forgotten_with_the_pause(
    game: Game,
) -> None:
    pacing = Pacing(game)
    pacing.set_pace(0.0, 'anna-1', steps=5)
    pacing.set_pace(0.3, '')
    assert pacing.offer(FIRST) == []
