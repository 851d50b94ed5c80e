"""A replay of an episode: what its keys do, and what is seen."""

from typing import Any

from humanopts_env.board import board_text
from humanopts_env.domains.base import Domain
from humanopts_env.domains.capabilities import board_of
from humanopts_env.game import Command, Game, Source
from humanopts_teach.bags.contents import Actors, Episode
from humanopts_teach.terminal.replay import FASTEST, Replay, SLOWEST, STEP_SECONDS
import pytest

START = 'taxi 0,0 passenger R destination G'
COMMANDS = (('/o#1', 1, 'fetch'), ('/o#1', 2, 'action:south'))


def episode(domain: Domain[Any], actions: list[str], number: int = 1) -> Episode:
    """Play one episode from a known state."""
    game = Game(domain)
    first = game.reset(START, 0, Source.MACHINE).transition
    assert first is not None
    moments = [first]
    for at, action in enumerate(actions):
        game.command(Command('/o#1', at + 1, Source.MACHINE, 1, at, action))
        moments.append(game.transition)
    return Episode('/game_state', '/game#1', number, (0, 0), lambda: moments)


@pytest.fixture
def replay(taxi: Domain[Any]) -> Replay:
    """Two episodes, of three steps and one."""
    episodes = [episode(taxi, ['pickup', 'south', 'east']), episode(taxi, ['east'], 2)]
    actors: Actors = {(sender, number): name for sender, number, name in COMMANDS}
    return Replay(taxi, episodes, lambda _: actors)


def words(replay: Replay) -> str:
    return next(line for line in replay.frame(100, 30) if line.startswith('episode'))


def test_each_step_shows_board_actor_action_and_reward(replay: Replay, taxi: Domain[Any]) -> None:
    first, second, third, last = replay.plain()
    assert board_text(board_of(taxi, taxi.decode(START))) in first
    assert second.startswith('episode 1 of 2 · step 1 of 3 · fetch: pickup')
    assert 'fetch: pickup (picked the passenger up) · reward 0, in all 0\n' in second
    assert 'action:south: south (went south) · reward -1, in all -1' in third
    assert 'machine: east (went east) · reward -1, in all -2 · left here' in last


def test_it_runs_to_the_last_step_and_stops(replay: Replay) -> None:
    for _ in range(5):
        replay.advance()
    assert (replay.running, 'step 3 of 3' in words(replay)) == (False, True)
    replay.press(' ')  # from the start again
    assert (replay.running, 'step 0 of 3' in words(replay)) == (True, True)


@pytest.mark.parametrize(
    ('keys', 'shown', 'running'),
    [
        ([' '], 'step 0', False),
        ([' ', ' '], 'step 0', True),
        (['right', 'right', 'left'], 'step 1', False),
        (['left'], 'step 0', False),
        (['right'] * 9, 'step 3', False),
        (['n'], 'episode 2 of 2', True),
        (['n', 'n', 'p', 'p'], 'episode 1 of 2', True),
        (['x', 'up', ''], 'step 0', True),
    ],
    ids=str,
)
def test_keys_move_through_the_recording(
    replay: Replay, keys: list[str], shown: str, running: bool
) -> None:
    for key in keys:
        replay.press(key)
    assert shown in words(replay)
    assert replay.running == running
    before = words(replay)
    replay.advance()
    assert (words(replay) != before) == running


def test_speed_doubles_and_halves_within_its_limits(replay: Replay) -> None:
    replay.press('+')
    assert replay.seconds == STEP_SECONDS / 2
    for key, limit in (('+', FASTEST), ('-', SLOWEST)):
        for _ in range(30):
            replay.press(key)
        assert replay.speed == limit


@pytest.mark.parametrize('key', ['q', 'escape', 'ctrl-c', 'ctrl-d'])
def test_it_can_be_quit(replay: Replay, key: str) -> None:
    replay.press(key)
    assert replay.over


@pytest.mark.parametrize('size', [(100, 30), (70, 20), (40, 16), (40, 8), (40, 1)])
def test_frame_fits_any_window(replay: Replay, size: tuple[int, int]) -> None:
    lines = replay.frame(*size)
    assert len(lines) == size[1]
    assert max(map(len, lines)) <= size[0]
