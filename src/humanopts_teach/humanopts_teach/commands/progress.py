"""The display of a running demo: the board, the lesson and the progress of learning."""

from typing import Any

from humanopts_env.board import board_text
from humanopts_env.colours import GREEN
from humanopts_env.domains.capabilities import board_of, pictured_board_of
from humanopts_learner.summary import OptionSummary
from humanopts_ros.limits import printable
from humanopts_teach.ros.conductor import Conductor
from humanopts_teach.terminal.device import usable_colours
from humanopts_teach.terminal.drawing import board_texts
from rich.console import Console, Group
from rich.live import Live
from rich.text import Text

_LINE_EVERY = 10  # number of demonstrations between lines, without a terminal
_OTHER_ROWS = 4  # rows of the picture, besides the board and the options


class DemoProgress:
    """
    Shows the progress of a demo: a live picture on a terminal, otherwise lines.

    Call it with the graph at any rate; it only draws changes.
    """

    def __init__(self) -> None:
        self._console = Console()
        self._live = Live(console=self._console, refresh_per_second=8)
        self._stage = 'starting the nodes'
        self._printed: set[str] = set()

    def __enter__(self) -> 'DemoProgress':
        if self._console.is_terminal:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._live.stop()

    def stage(self, text: str) -> None:
        """Show the name of the next part of the work."""
        self._stage = text
        if self._console.is_terminal:
            self._live.update(Text(f'\n{text} ...'))
        else:
            self._print_once(text, f'{text} ...')

    def evaluating(self, done: float, total: float, text: str) -> None:
        """Show the progress of the evaluation on a terminal."""
        if self._console.is_terminal:
            self._live.update(Text(f'\n{self._stage}: {text} ({done / total:.0%})'))

    def comparing(self, done: float, total: float, text: str) -> None:
        """Show the progress of the games; print lines if there is no terminal."""
        self.evaluating(done, total, text)
        if not self._console.is_terminal:
            self._print_once(text, f'{done / total:4.0%} {text}')

    def __call__(self, graph: Conductor) -> None:
        """Show the current state of the graph."""
        world, options = graph.client.world, graph.client.world.summaries
        lines = [f'{option.option_name}: {_progress(option)}' for option in options]
        if not self._console.is_terminal:
            if world.domain is not None and graph.state is not None:
                first = board_text(board_of(world.domain, graph.state.state))
                self._print_once('first state', 'the first state:', Text(first))
            for option, line in zip(options, lines):
                tens = (option.n_demonstrations + option.n_not_here) // _LINE_EVERY
                self._print_once(f'{option.option_name} {tens} {option.learned}', line)
            return
        parts: list[Any] = [Text(f'\n{self._stage}', style='bold')]
        if world.domain is not None and graph.state is not None:
            width, height = self._console.size
            board = pictured_board_of(world.domain, graph.state.state)
            rows, colours = height - len(lines) - _OTHER_ROWS, usable_colours(self._console)
            parts += board_texts(board, width, rows, colours)
        parts += [Text(s, GREEN if o.learned else '') for o, s in zip(options, lines)]
        if hasattr(played := graph.feedback, 'fallbacks'):
            counts = (
                f'{played.episodes} episodes played, {played.successes} done, '
                f'{played.fallbacks} fallbacks, mean return {played.mean_return:.2f}'
            )
            parts.append(Text(counts))
        self._live.update(Group(*parts))

    def _print_once(self, key: str, *texts: str | Text) -> None:
        """Print texts, once for each key."""
        if key not in self._printed:
            self._printed.add(key)
            for text in texts:
                line = printable(text) if isinstance(text, str) else text
                self._console.print(line, highlight=False, markup=False, soft_wrap=True)


def _progress(option: OptionSummary) -> str:
    measured = [
        f'{c.name} {c.value:.3g} ({"≥" if c.at_least else "≤"} {c.threshold:.3g}'
        f'{f", {c.verdict}" if c.undecided else ""})'
        for c in option.criteria
        if c.value is not None and c.threshold is not None
    ]
    measured += [f'{c.name} {c.verdict}: {c.obstacle}' for c in option.criteria if c.obstacle]
    shown = f'{option.n_demonstrations} shown, {option.n_not_here} not here'
    return '; '.join([shown, ', '.join(measured) or 'criteria not yet measurable', option.status])
