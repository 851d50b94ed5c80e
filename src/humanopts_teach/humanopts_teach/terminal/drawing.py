"""Rendering of the screen as lines of text."""

from collections.abc import Iterator, Sequence
from io import StringIO
from typing import Literal

from humanopts_env.board import Board, caption, runs, signs
from humanopts_env.colours import GREEN, ORANGE, RED, TEAL
from humanopts_ros.limits import one_line
from humanopts_teach.dialogue import panel
from humanopts_teach.dialogue.app import App
from humanopts_teach.dialogue.entry import PAGE
from humanopts_teach.dialogue.view import view
from rich.cells import cell_len, set_cell_size
from rich.console import Console, ConsoleOptions, Group, RenderableType
from rich.padding import Padding
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

SMALLEST = (70, 20)  # columns, rows
_WIDE_BESIDE = 50  # minimum columns next to the board to place the whole panel there
_ROOMY = 24  # rows; taller screens have a gap below the header
Colours = Literal['auto', 'standard', '256', 'truecolor', 'windows']
KEY = f'bold {TEAL}'  # style of key labels
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
    Return the screen as ``height`` lines of at most ``width`` cells.

    :param colours: colour system, in rich's notation; None: plain text.
    """
    if width < SMALLEST[0] or height < SMALLEST[1]:
        words = (
            f'This window has {width} x {height} characters, and {SMALLEST[0]} x {SMALLEST[1]} '
            'are needed: please make it larger. (Ctrl-C quits; everything taught is saved.)'
        )
        return framed([Text(words)], [], width, height, colours)
    shown = view(app)
    top: list[RenderableType] = [title(' · '.join(shown.head), width)]
    if shown.paused:
        why = Text.assemble(('PAUSED: ', 'bold'), one_line(shown.paused), overflow='ellipsis')
        why.no_wrap = height < _ROOMY
        top.append(Padding(why, (0, 1), style=f'color(231) on {RED}'))
    if height > _ROOMY:
        top.append(Text())
    top.append(_middle(shown, width))
    keys = [(key.label, key.words) for key in shown.keys if key.label]
    foot = [Text('─' * width, 'dim'), drawn(shown.said), *key_bar(keys, width)]
    return framed(top, foot, width, height, colours)


def title(words: str, width: int) -> Text:
    """Return the first line of the screen."""
    return Text(set_cell_size(one_line(f' {words}'), width), 'reverse')


def framed(
    top: Sequence[RenderableType],
    foot: Sequence[RenderableType],
    width: int,
    height: int,
    colours: Colours | None,
) -> list[str]:
    """Return ``height`` lines: the top, truncated if too long, and the foot below it."""
    upper, lower = (_lines_of(Group(*part), width, colours) for part in (top, foot))
    room = height - len(lower)
    if len(upper) > room:
        upper = [*upper[: max(room - 1, 0)], '... (a higher window shows more)']
    return (upper + [''] * room)[:room] + lower


def _lines_of(group: Group, width: int, colours: Colours | None) -> list[str]:
    if not group.renderables:
        return []
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
    console.print(_Printable(group))
    return [line.rstrip() for line in file.getvalue().rstrip('\n').split('\n')]


class _Printable:
    """A renderable without terminal control characters."""

    def __init__(self, renderable: RenderableType) -> None:
        self._renderable = renderable

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Segment]:
        """Yield the segments; control characters have zero width, so the layout is unchanged."""
        for text, style, control in console.render(self._renderable, options):
            plain = ''.join(c for c in text if c.isprintable() or c == '\n')
            yield Segment(plain, style, control)


def _middle(view: panel.ScreenView, width: int) -> RenderableType:
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
    Return a coloured board and the lines below it, which may be wider.

    A domain without a drawing shows a list of its features instead of a board.
    """
    drawn, below = signs(board), caption(board)
    if not drawn:
        drawn, below = caption(board, width=0), []
    board_text, notes = (
        Text('\n').join(Text.assemble(*runs(line)) for line in lines) for lines in (drawn, below)
    )
    return board_text, notes


def drawn(block: panel.Block) -> RenderableType:
    """Render a block of a panel."""
    match block:
        case panel.Page(text):
            from rich.markdown import Markdown  # needed only in studies

            return Markdown(text)
        case panel.Line():
            pieces = (block, *block.more)
            return Text.assemble(*((one_line(piece.text), _style(piece)) for piece in pieces))
        case panel.TypedText(text):
            return Text.assemble('> ', (text, 'bold'), ('█', TEAL), overflow='fold')
        case panel.Features(shown, hidden):
            parts: list[str | tuple[str, str]] = [('depends on: ', 'dim')]
            for number, (name, value) in enumerate(shown):
                parts += [(', ' if number else '', 'dim'), name]
                parts.append((f' {value}' if value else '', f'bold {TEAL}'))
            return Text.assemble(*parts, (f'; {hidden}' if hidden else '', 'dim'))
    table = Table.grid(padding=(0, 2, 0, 0))
    match block:
        case panel.KeyList(rows):
            table.add_column(justify='right', style=KEY)
            for key, words in rows:
                table.add_row(Text(key), Text(words))
        case panel.Criteria(criteria):
            for row in criteria:
                style = STYLES[row.tone]
                name = Text.assemble((row.mark, style), f' {row.name}')
                table.add_row(name, Text(row.now, style), Text(row.needs, 'dim'))
        case panel.Choices(items, at):
            table = Table.grid()
            first = at - at % PAGE
            for number, (words, note) in enumerate(items[first : first + PAGE]):
                chosen = first + number == at
                mark = Text('> ' if chosen else '  ', KEY, no_wrap=True)
                item = (one_line(f'{number + 1} {words}'), 'bold' if chosen else '')
                table.add_row(mark, Text.assemble(item, (one_line(f'  {note}'), 'dim')))
    return table


def _style(line: panel.Line) -> str:
    return f'{STYLES[line.tone]} {"bold" if line.strong else ""}'


def key_bar(keys: Sequence[tuple[str, str]], width: int) -> list[Text]:
    """Return the key labels and descriptions in as few lines as possible, without line breaks."""
    lines = [Text()]
    for key, words in keys:
        entry = Text.assemble((key, KEY), ' ', words)
        if lines[-1].cell_len + 2 + entry.cell_len > width:
            lines.append(Text())
        lines[-1].append('  ' if lines[-1].plain else '').append_text(entry)
    return lines
