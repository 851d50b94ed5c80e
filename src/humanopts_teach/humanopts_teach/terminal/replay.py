"""A text replay of recorded episodes: keys and screen."""

from collections.abc import Callable, Iterator, Sequence
import math
from typing import Any

from humanopts_env.board import board_text
from humanopts_env.domains.base import Domain
from humanopts_env.domains.capabilities import board_of, pictured_board_of
from humanopts_env.game import effect_between
from humanopts_ros.limits import one_line
from humanopts_teach.bags.contents import actor_of, Actors, Episode, source_of
from humanopts_teach.dialogue.keys import END_OF_FILE, ESCAPE, INTERRUPT, LEFT, RIGHT, SPACE
from humanopts_teach.terminal.drawing import board_texts, Colours, framed, key_bar, title
from rich.console import Group
from rich.text import Text

STEP_SECONDS = 0.5  # duration of a step at speed 1
SLOWEST, FASTEST = 1 / 16, 64.0
_ROOM_FOR_KEYS = 16  # minimum number of rows to show the keys
_KEYS = (
    *(('Space', 'pause, resume'), ('← →', 'one step'), ('+ -', 'speed')),
    *(('n p', 'next, previous episode'), ('q', 'quit')),
)
_QUIT = {'q', 'Q', ESCAPE, INTERRUPT, END_OF_FILE}


class Replay:
    """
    The position and speed of a replay.

    :ivar running: whether steps are shown continuously until the episode ends.
    :ivar over: whether the person has quit.
    """

    def __init__(
        self,
        domain: Domain,
        episodes: Sequence[Episode],
        actors_of: Callable[[Episode], Actors],
        index: int = 0,
        speed: float = 1.0,
    ) -> None:
        """
        Start at the first step of an episode.

        :param episodes: at least one episode; each is read when shown.
        :param actors_of: function that returns the senders of an episode's commands.
        :param index: index of the first episode, from 0.
        :param speed: relative speed; 2 is twice as fast.
        """
        self._domain, self._episodes, self._actors_of = domain, episodes, actors_of
        self._index = self._step = 0
        self._begin(index)
        self.speed = speed
        self.running, self.over = True, False

    @property
    def seconds(self) -> float:
        """The time in seconds for which a step is shown."""
        return STEP_SECONDS / self.speed

    @property
    def _last(self) -> int:
        return len(self._episode.transitions) - 1

    def advance(self) -> None:
        """Show the next step if the replay is running; stop at the last one."""
        if self.running:
            self._go(self._step + 1)
            self.running = self._step < self._last

    def press(self, key: str) -> None:
        """Handle a key; ignore unknown keys."""
        if key in _QUIT:
            self.over = True
        elif key == SPACE:
            if self._step == self._last and not self.running:
                self._step = 0
            self.running = not self.running
        elif key in (LEFT, RIGHT):
            self.running = False
            self._go(self._step + (1 if key == RIGHT else -1))
        elif key in ('+', '=', '-'):
            faster = self.speed * (0.5 if key == '-' else 2)
            self.speed = min(max(faster, SLOWEST), FASTEST)
        elif key in ('n', 'p'):
            self._turn(1 if key == 'n' else -1)

    def frame(self, width: int, height: int, colours: Colours | None = None) -> list[str]:
        """Return the screen as ``height`` lines of at most ``width`` cells."""
        how = f'speed {self.speed:g}' if self.running else 'paused'
        head = title(f'humanopts · {self._domain.name} · {how}', width)

        def middle(rows: int) -> Group:
            board = pictured_board_of(self._domain, self._state)
            parts = board_texts(board, width, rows - 2, colours)
            return Group(*parts, Text(), Text(self._words(), 'bold'))

        keys = [Text('─' * width, 'dim'), *key_bar(_KEYS, width)]
        foot = keys if height >= _ROOM_FOR_KEYS else []
        return framed([head, Text()], middle, foot, width, height, colours)

    def plain(self) -> Iterator[str]:
        """Yield each step of the episode as text."""
        for step in range(self._last + 1):
            self._step = step
            yield '\n'.join([self._words(), board_text(board_of(self._domain, self._state)), ''])

    def _go(self, step: int) -> None:
        self._step = min(max(step, 0), self._last)

    def _begin(self, index: int) -> None:
        """Start at the first step of an episode."""
        self._index, self._step = index, 0
        self._episode = self._episodes[index]
        self._actors = self._actors_of(self._episode)

    def _turn(self, by: int) -> None:
        index = self._index + by
        if 0 <= index < len(self._episodes):
            self._begin(index)
            self.running = True

    @property
    def _state(self) -> Any:
        return self._domain.decode(self._episode.transitions[self._step].state)

    def _words(self) -> str:
        """Return the position, the actor, the action and its reward."""
        episode, transitions = self._episode, self._episode.transitions
        at = transitions[self._step]
        parts = [
            f'episode {self._index + 1} of {len(self._episodes)}',
            f'step {at.step} of {transitions[-1].step}',
        ]
        if at.previous_action:
            who = actor_of(at, self._actors) or source_of(at)
            gained = math.fsum(transition.reward for transition in transitions[: self._step + 1])
            before = transitions[max(self._step - 1, 0)]
            known = at.follows(before)
            effect = f' ({effect_between(self._domain, before, at).text})' if known else ''
            parts.append(f'{who}: {at.previous_action}{effect}')
            parts.append(f'reward {at.reward:g}, in all {gained:g}')
        if self._step == self._last:
            parts.append(_ending(episode))
        return one_line(' · '.join(parts))


def _ending(episode: Episode) -> str:
    last = episode.transitions[-1]
    if last.terminated:
        return 'the task is over'
    return 'cut off at the step limit' if last.truncated else 'left here'
