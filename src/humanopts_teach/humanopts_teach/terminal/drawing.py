"""The whole screen as lines of a given size."""

from collections.abc import Iterator, Sequence
from functools import singledispatch
from io import StringIO
from typing import Literal

from humanopts_env.board import Board, caption, runs, signs
from humanopts_env.colours import GREEN, ORANGE, RED, TEAL
from humanopts_ros.limits import one_line
from humanopts_teach.dialogue import panel
from humanopts_teach.dialogue.app import App
from humanopts_teach.dialogue.entry import PAGE
from rich.cells import cell_len, set_cell_size
from rich.console import Console, ConsoleOptions, Group, RenderableType
from rich.padding import Padding
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

SMALLEST = (70, 20)  # columns, rows
_WIDE_BESIDE = 50  # columns beside the board that hold everything
_ROOMY = 24  # rows; above, there is a gap below the head
Colours = Literal['auto', 'standard', '256', 'truecolor', 'windows']
KEY = f'bold {TEAL}'  # a key that can be pressed
STYLES = {
    panel.Tone.PLAIN: '',
    panel.Tone.QUIET: 'dim',
    panel.Tone.NEWS: TEAL,
    panel.Tone.GOOD: GREEN,
    panel.Tone.WARNING: ORANGE,
    panel.Tone.BAD: f'bold {RED}',
}


def frame(app: App, width: int, height: int, colours: Colours | None = None) -> list[str]:
    """
    Return the screen as ``height`` lines, each ``width`` cells wide at most.

    :param colours: as rich names what the terminal can do; None: plain text.
    """
    if width < SMALLEST[0] or height < SMALLEST[1]:
        return fit(lines_of(_too_small(width, height), width, colours), height)
    shown = panel.view(app)
    rule = Text('─' * width, 'dim')
    foot = Group(rule, drawn(shown.said), *key_bar(shown.keys, width))
    bottom = lines_of(foot, width, colours)
    gap = [Text()] if height > _ROOMY else []
    middle = Group(_head(shown, width), *_pause(shown, height), *gap, _middle(shown, width))
    top = lines_of(middle, width, colours)
    return fit(top, height - len(bottom)) + bottom


def lines_of(renderable: RenderableType, width: int, colours: Colours | None) -> list[str]:
    """
    Lay something out.

    :param colours: as for ``frame``.
    """
    file = StringIO()
    console = Console(
        file=file,
        width=width,
        force_terminal=colours is not None,
        color_system=colours,
        legacy_windows=False,
        highlight=False,
        markup=False,
        emoji=False,
    )
    console.print(_Printable(renderable))
    return [line.rstrip() for line in file.getvalue().rstrip('\n').split('\n')]


class _Printable:
    """Something laid out, without the characters that would control the terminal."""

    def __init__(self, renderable: RenderableType) -> None:
        self._renderable = renderable

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Segment]:
        """Yield the parts; those characters are no cell wide, so that none moves."""
        for text, style, control in console.render(self._renderable, options):
            plain = ''.join(c for c in text if c.isprintable() or c == '\n')
            yield Segment(plain, style, control)


def fit(lines: list[str], height: int) -> list[str]:
    """Cut or fill to the height, and say so when something is cut."""
    if len(lines) > height:
        lines = [*lines[: max(height - 1, 0)], '... (a higher window shows more)']
    return (lines + [''] * height)[:height]


def _too_small(width: int, height: int) -> Text:
    need = f'{SMALLEST[0]} x {SMALLEST[1]}'
    return Text(
        f'This window has {width} x {height} characters, and {need} are needed: please make it '
        'larger. (Ctrl-C quits; everything taught is saved.)'
    )


def _head(view: panel.View, width: int) -> Text:
    return Text(set_cell_size(one_line(f' {" · ".join(view.head)}'), width), 'reverse')


def _pause(view: panel.View, height: int) -> list[RenderableType]:
    """Return why nothing new can be taught now; in a low window its beginning."""
    if not view.paused:
        return []
    why = Text.assemble(('PAUSED: ', 'bold'), one_line(view.paused), overflow='ellipsis')
    why.no_wrap = height < _ROOMY
    return [Padding(why, (0, 1), style=f'color(231) on {RED}')]


def _middle(view: panel.View, width: int) -> RenderableType:
    beside, below = (Group(*map(drawn, part)) for part in (view.panel.beside, view.panel.below))
    if view.board is None:
        return beside
    board, notes = board_texts(view.board)
    board_width = max(cell_len(line) for line in board.plain.split('\n'))
    table = Table.grid(padding=(0, 3, 0, 0), expand=True)
    table.add_column(width=board_width, no_wrap=True)
    table.add_column(ratio=1)
    if width - board_width < _WIDE_BESIDE:
        table.add_row(board, beside)
        return Group(table, notes, below)
    table.add_row(board, Group(beside, below))
    return Group(table, notes)


def board_texts(board: Board) -> tuple[Text, Text]:
    """
    Return a board in colour, and the lines below it, which may be wider.

    A world that is not drawn has a list of its features in place of a board.
    """
    drawn, below = signs(board), caption(board)
    if not drawn:
        drawn, below = caption(board, width=0), []
    board_text, notes = (
        Text('\n').join(Text.assemble(*runs(line)) for line in lines) for lines in (drawn, below)
    )
    return board_text, notes


@singledispatch
def drawn(block: panel.Block) -> RenderableType:
    """Draw a part of a panel."""
    raise TypeError(f'{type(block).__name__} cannot be drawn')


@drawn.register
def _page(page: panel.Page) -> RenderableType:
    from rich.markdown import Markdown  # only studies have such pages

    return Markdown(page.text)


@drawn.register
def _line(line: panel.Line) -> RenderableType:
    text = Text(one_line(line.text), _style(line))
    for piece in line.more:
        text.append(one_line(piece.text), _style(piece))
    return text


def _style(line: panel.Line) -> str:
    return ' '.join(filter(None, (STYLES[line.tone], 'bold' if line.strong else '')))


@drawn.register
def _typed(typed: panel.TypedText) -> RenderableType:
    return Text.assemble('> ', (typed.text, 'bold'), ('█', TEAL), overflow='fold')


@drawn.register
def _choices(choices: panel.Choices) -> RenderableType:
    table, first = Table.grid(), choices.at - choices.at % PAGE
    for number, item in enumerate(choices.items[first : first + PAGE]):
        chosen = first + number == choices.at
        mark = Text('> ' if chosen else '  ', KEY, no_wrap=True)
        name = (one_line(f'{number + 1} {item.text}'), 'bold' if chosen else '')
        table.add_row(mark, Text.assemble(name, (one_line(f'  {item.note}'), 'dim')))
    return table


@drawn.register
def _key_table(keys: panel.KeyList) -> RenderableType:
    table = Table.grid(padding=(0, 2))
    for key, words in keys.rows:
        table.add_row(Text(key, KEY, justify='right'), Text(words))
    return table


@drawn.register
def _features(features: panel.Features) -> RenderableType:
    text = Text('depends on: ', 'dim')
    for number, feature in enumerate(features.shown):
        text.append(', ' if number else '', 'dim')
        text.append(feature.name, 'not dim')
        if feature.value:
            text.append(f' {feature.value}', f'not dim bold {TEAL}')
    if features.hidden:
        text.append(f'; {features.hidden}', 'dim')
    return text


@drawn.register
def _criteria(criteria: panel.Criteria) -> RenderableType:
    table = Table.grid(padding=(0, 2, 0, 0))
    for shown in criteria.rows:
        style = STYLES[shown.tone]
        name = Text(f'{shown.mark} {shown.name}')
        name.stylize(style, 0, 1)
        table.add_row(name, Text(shown.now, style), Text(shown.needs, 'dim'))
    return table


def key_bar(keys: Sequence[tuple[str, str]], width: int) -> list[Text]:
    """Return keys and what they do in as few lines as they fit in, none broken in two."""
    lines = [Text()]
    for key, words in keys:
        entry = Text.assemble((key, KEY), ' ', words)
        if lines[-1].cell_len + 2 + entry.cell_len > width:
            lines.append(Text())
        lines[-1].append('  ' if lines[-1].plain else '').append_text(entry)
    return lines
