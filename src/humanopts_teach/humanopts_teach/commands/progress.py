"""What a person watches while a demo runs: the board, the lesson, the criteria."""

from typing import Any

from humanopts_env.board import board_text
from humanopts_env.colours import GREEN
from humanopts_env.domains.capabilities import board_of
from humanopts_learner.ros.convert import summary_from_message
from humanopts_learner.summary import OptionSummary
from humanopts_ros.limits import printable
from humanopts_teach.ros.graph_client import GraphClient
from humanopts_teach.terminal.drawing import board_texts
from rich.console import Console, Group
from rich.live import Live
from rich.text import Text

_LINE_EVERY = 10  # demonstrations, where lines are printed instead of a live picture


class DemoProgress:
    """
    Shows how far a demo is, live on a terminal and as lines anywhere else.

    Call it with the graph as often as wanted; it draws only what changed.
    """

    def __init__(self) -> None:
        self._console = Console()
        self._live = Live(console=self._console, refresh_per_second=8)
        self._stage = 'starting the nodes'
        self._said: set[str] = set()

    def __enter__(self) -> 'DemoProgress':
        if self._console.is_terminal:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._live.stop()

    def stage(self, text: str) -> None:
        """Begin the next part of the work."""
        self._stage = text
        if self._console.is_terminal:
            self._live.update(Text(f'\n{text} ...'))
        else:
            self._say(f'{text} ...')

    def __call__(self, graph: GraphClient) -> None:
        """Draw the graph's current values."""
        if self._console.is_terminal:
            self._live.update(self._picture(graph))
        else:
            self._lines(graph)

    def evaluating(self, done: float, total: float, text: str) -> None:
        """Show how far the evaluation of the bag is."""
        if self._console.is_terminal:
            self._live.update(Text(f'\n{self._stage}: {text} ({done / total:.0%})'))

    def comparing(self, done: float, total: float, text: str) -> None:
        """Show what plays many games, as lines too."""
        self.evaluating(done, total, text)
        if not self._console.is_terminal:
            self._say(f'{done / total:4.0%} {text}', key=text)

    def _picture(self, graph: GraphClient) -> Group:
        parts: list[Any] = [Text(f'\n{self._stage}', style='bold')]
        if graph.domain is not None and graph.state is not None:
            parts += board_texts(board_of(graph.domain, graph.state.state))
        for option in graph.learning.options if graph.learning else ():
            found = summary_from_message(option)
            style = GREEN if found.criteria_met else ''
            parts.append(Text(f'{found.option_name}: {_criteria_words(found)}', style))
        if hasattr(played := graph.feedback, 'fallbacks'):
            counts = (
                f'{played.episodes} episodes played, {played.successes} done, '
                f'{played.fallbacks} fallbacks, mean return {played.mean_return:.2f}'
            )
            parts.append(Text(counts))
        return Group(*parts)

    def _lines(self, graph: GraphClient) -> None:
        if graph.domain is not None and graph.state is not None:
            board = board_text(board_of(graph.domain, graph.state.state))
            self._say('the first state:\n' + board, key='first state')
        for option in graph.learning.options if graph.learning else ():
            tens = (option.n_demonstrations + option.n_not_here) // _LINE_EVERY
            key = f'{option.option_name} {tens} {option.criteria_met}'
            words = _criteria_words(summary_from_message(option))
            self._say(f'{option.option_name}: {words}', key)

    def _say(self, text: str, key: str = '') -> None:
        if (key or text) not in self._said:
            self._said.add(key or text)
            self._console.print(printable(text), highlight=False, markup=False, soft_wrap=True)


def _criteria_words(option: OptionSummary) -> str:
    measured = [
        f'{c.name} {c.value:.3g} (target {c.threshold:.3g}{", " * c.undecided}'
        f'{c.verdict * c.undecided})'
        for c in option.criteria
        if c.value is not None and c.threshold is not None
    ]
    met = 'criteria met' if option.criteria_met else 'criteria not met yet'
    measured += [f'{c.name} {c.verdict}: {c.obstacle}' for c in option.criteria if c.obstacle]
    shown = f'{option.n_demonstrations} shown, {option.n_not_here} not here'
    return '; '.join([shown, ', '.join(measured) or 'criteria not yet measurable', met])
