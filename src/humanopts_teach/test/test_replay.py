"""A replay of an episode: what its keys do, and what is seen."""

from humanopts_env.board import board_text
from humanopts_env.domains.base import Domain
from humanopts_env.domains.capabilities import board_of
from humanopts_env.game import Command, Game, Source
from humanopts_teach.bags.contents import Actors, Episode
from humanopts_teach.terminal.replay import Replay
import pytest
from teach_support import snapshot

START = 'taxi 0,0 passenger R destination G'
ACTORS: Actors = {('/o#1', 1): 'fetch', ('/o#1', 2): 'action:south'}
KEYS = (  # a point: a step passes
    '. . . . space . space left . right right right n . p p . x + + - space space - - - - - - - -'
)


def episode(domain: Domain, *actions: str) -> Episode:
    """Play one episode from a known state."""
    game = Game(domain)
    moments = [game.reset(START, 0, Source.MACHINE).transition]
    for at, action in enumerate(actions):
        game.command(Command('/o#1', at + 1, Source.MACHINE, 1, at, action))
        moments.append(game.transition)
    return Episode('/game_state', '/game#1', 1, (0, 0), lambda: [m for m in moments if m])


@pytest.fixture
def replay(taxi: Domain) -> Replay:
    """Two episodes, of three steps and one."""
    episodes = episode(taxi, 'pickup', 'south', 'east'), episode(taxi, 'east')
    return Replay(taxi, episodes, lambda _: ACTORS)


def test_keys_move_through_the_recording(replay: Replay, taxi: Domain) -> None:
    """A point lets a step pass; the head has the speed, and the line below the board the step."""
    lines = []
    for key in KEYS.split():
        if key == '.':
            replay.advance()
        else:
            replay.press(' ' if key == 'space' else key)
        head, *rest = replay.frame(100, 30)
        (words,) = [line for line in rest if line.startswith('episode')]
        lines.append(f'{key:6} {head.rpartition("·")[2].strip():12} {words}')
    snapshot.check('replay.txt', '\n'.join(lines))
    assert board_text(board_of(taxi, taxi.decode(START))) in next(replay.plain())


@pytest.mark.parametrize('key', ['q', 'escape', 'ctrl-c', 'ctrl-d'])
def test_it_can_be_quit(replay: Replay, key: str) -> None:
    replay.press(key)
    assert replay.over


@pytest.mark.parametrize('size', [(100, 30), (70, 20), (40, 16), (40, 8), (40, 1)])
def test_frame_fits_any_window(replay: Replay, size: tuple[int, int]) -> None:
    lines = replay.frame(*size)
    assert len(lines) == size[1]
    assert max(map(len, lines)) <= size[0]
