"""Rendering of the screen as lines of text."""

from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache, partial
from io import StringIO
from typing import Literal

from humanopts_env.board import Board, caption, Image, runs, signs
from humanopts_env.colours import GREEN, ORANGE, RED, TEAL
from humanopts_ros.limits import one_line
from humanopts_teach.dialogue import panel
from humanopts_teach.dialogue.app import App
from humanopts_teach.dialogue.entry import PAGE
from humanopts_teach.dialogue.view import view
from humanopts_teach.language import _, in_its_language
import numpy as np
from PIL import Image as Pillow
from rich.cells import cell_len, set_cell_size
from rich.color import Color
from rich.columns import Columns
from rich.console import Console, ConsoleOptions, Group, RenderableType
from rich.padding import Padding
from rich.segment import Segment
from rich.style import Style
from rich.table import Table
from rich.text import Text

SMALLEST = (70, 20)  # columns, rows
_WIDE_BESIDE = 50  # minimum columns next to the board to place the whole panel there
_GAP = 3  # columns between the board and the panel
_READABLE = 90  # columns; longer lines of text are harder to read
_ROOMY = 24  # rows; taller screens have a gap below the header
_LONG_NAME = 30  # columns; longer names of features, which are formulas, are not aligned
_LONG_LIST = 12  # options; longer lists have several columns
_UPPER_HALF = '▀'  # its foreground is the upper of two pixels, its background the lower one
_COLOUR_BITS = 0xF8  # of each colour channel, so that neighbouring pixels are often equal
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


@in_its_language
def frame(app: App, width: int, height: int, colours: Colours | None = None) -> list[str]:
    """
    Return the screen as ``height`` lines of at most ``width`` cells.

    :param colours: colour system, in rich's notation; None: plain text.
    """
    if width < SMALLEST[0] or height < SMALLEST[1]:
        words = _(
            'This window has {width} x {height} characters, but {least} x {lines} are needed: '
            'please make it larger. (Ctrl-C quits; everything taught is saved.)'
        )
        least, lines = SMALLEST
        words = words.format(width=width, height=height, least=least, lines=lines)
        return framed([Text(words)], lambda rows: Text(), [], width, height, colours)
    shown = view(app, images=colours is not None)
    top: list[RenderableType] = [title(' · '.join(shown.head), width)]
    if shown.paused:
        why = Text.assemble((_('PAUSED: '), 'bold'), one_line(shown.paused), overflow='ellipsis')
        why.no_wrap = height < _ROOMY
        top.append(Padding(why, (0, 1), style=f'color(231) on {RED}'))
    if shown.task:
        top.append(Padding(Text(one_line(shown.task), TEAL), (0, 1)))
    if height > _ROOMY:
        top.append(Text())
    keys = [(key.label, key.words) for key in shown.keys if key.label]
    foot = [Text('─' * width, 'dim'), drawn(shown.said), *key_bar(keys, width)]
    middle = partial(_middle, shown, width, colours)
    return framed(top, middle, foot, width, height, colours, app.screen.scroll)


def title(words: str, width: int) -> Text:
    """Return the first line of the screen."""
    return Text(set_cell_size(one_line(f' {words}'), width), 'reverse')


def framed(
    top: Sequence[RenderableType],
    middle: Callable[[int], RenderableType],
    foot: Sequence[RenderableType],
    width: int,
    height: int,
    colours: Colours | None,
    scroll: int | None = None,
) -> list[str]:
    """
    Return ``height`` lines: top and middle, truncated if too long, and the foot below them.

    :param middle: function that returns the middle for a number of rows, which an image fills.
    :param scroll: number of lines of the middle that are scrolled away; None: it does not scroll.
    """
    upper, lower = (_lines_of(Group(*part), width, colours) for part in (top, foot))
    room = max(height - len(lower) - len(upper), 0)
    lines = _lines_of(Group(middle(room)), width, colours)
    if len(lines) > room:
        hint, shown = _('... (a taller window shows more)'), max(room - 1, 0)
        first = min(scroll or 0, len(lines) - shown)
        if scroll is not None:
            hint = _('... ↓ shows more') if first + shown < len(lines) else _('↑ goes back up')
        lines = [*lines[first : first + shown], hint]
    return upper + (lines + [''] * room)[:room] + lower


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
            if not text.isprintable():
                text = ''.join(c for c in text if c.isprintable() or c == '\n')
            yield Segment(text, style, control)


def _middle(
    view: panel.ScreenView, width: int, colours: Colours | None, rows: int
) -> RenderableType:
    beside, below = (Group(*map(drawn, part)) for part in (view.panel.beside, view.panel.below))
    if view.board is None:
        return Padding(Group(beside, below), (0, max(width - _READABLE, 0), 0, 0))
    room = max(width // 2, width - _GAP - _WIDE_BESIDE)  # for an image
    if view.board.image is not None:
        text = _lines_of(Group(beside, below), width - room - _GAP, None)
        room = room if len(text) <= rows else width // 3
    board, notes = board_texts(view.board, room, rows, colours)
    board_width = (
        board.width
        if isinstance(board, HalfBlocks)
        else max(cell_len(line) for line in board.plain.split('\n'))
    )
    table = Table.grid(padding=(0, _GAP, 0, 0), expand=True)
    table.add_column(width=board_width, no_wrap=True)
    table.add_column(ratio=1)
    if view.board.rows and width - board_width < _WIDE_BESIDE:
        table.add_row(board, beside)
        return Group(table, notes, below)
    table.add_row(board, Group(beside, below))
    return Group(table, notes)


def board_texts(
    board: Board, width: int, height: int, colours: Colours | None
) -> tuple['Text | HalfBlocks', Text]:
    """
    Return a coloured board or an image, and the lines below it, which may be wider.

    Cells are twice as large if there is room. A domain without a drawing shows a list of its
    features instead of a board.

    :param width: columns available; ``height``: rows, including the lines below.
    :param colours: None: images cannot be drawn.
    """
    image = board.image if colours is not None else None
    drawn, below = signs(board, 2), caption(board)
    fits = height > _ROOMY and len(drawn) + len(below) <= height
    if not (board.rows and fits and len(drawn[0]) <= width):
        drawn = signs(board)
    if not drawn and image is None:
        drawn, below = caption(board, width=0), []
    board_text, notes = (
        Text('\n').join(Text.assemble(*runs(line)) for line in lines) for lines in (drawn, below)
    )
    if image is not None:
        return HalfBlocks(image, width, max(height - len(below), 1)), notes
    return board_text, notes


class HalfBlocks:
    """
    An image as lines of half blocks, at the largest size that fits.

    A character shows two pixels, one above the other. As it is about twice as high as wide, the
    pixels are square. The colour of a pixel is the mean of its area.

    :ivar width: columns.
    """

    def __init__(self, image: Image, width: int, height: int) -> None:
        """
        Scale an image.

        :param width: available columns, at least 1; ``height``: rows, at least 1.
        """
        rows, columns, _ = image.shape
        scale = min(width / columns, 2 * height / rows)
        self.width, down = max(1, round(scale * columns)), max(1, round(scale * rows / 2))
        small = Pillow.fromarray(image).resize((self.width, 2 * down), Pillow.Resampling.BOX)
        pixels = np.asarray(small).reshape(down, 2, self.width, 3) & _COLOUR_BITS
        self._pairs = pixels.swapaxes(1, 2).reshape(down, self.width, 6)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Segment]:
        """Yield a segment for each run of equal characters."""
        for pairs in self._pairs:
            changes = (np.flatnonzero((pairs[1:] != pairs[:-1]).any(axis=1)) + 1).tolist()
            starts, ends = [0, *changes], [*changes, self.width]
            for pair, start, end in zip(pairs[starts].tolist(), starts, ends):
                yield Segment(_UPPER_HALF * (end - start), _pixel_style(*pair))
            yield Segment.line()


@lru_cache(4096)
def _pixel_style(*values: int) -> Style:
    """Return the style of a half block: red, green and blue of the upper and the lower pixel."""
    return Style(color=Color.from_rgb(*values[:3]), bgcolor=Color.from_rgb(*values[3:]))


def drawn(block: panel.Block) -> RenderableType:
    """Render a block of a panel."""
    match block:
        case panel.Page(text):
            from rich.markdown import Markdown  # needed only in studies

            return Markdown(text)
        case panel.Line():
            pieces = (block, *block.more)
            return Text.assemble(*((one_line(piece.text), _style(piece)) for piece in pieces))
        case panel.Rating(points, low, high):
            scale = Text(' ')
            for number in range(1, points + 1):
                text = f'[{number}]' if number == block.value else f' {number} '
                scale.append(text, KEY if number == block.value else '')
            ends = Text.assemble((f'1 = {low}   {points} = {high}', 'dim'))
            return Group(scale, ends)
        case panel.Options(texts, picked):
            marks = ('☐', '☑') if block.several else ('○', '●')
            answers = [
                Text.assemble(
                    (f'{key} ', KEY),
                    f'{marks[number in picked]} ',
                    (one_line(text), 'bold' if number in picked else ''),
                )
                for number, (key, text) in enumerate(zip(panel.OPTION_KEYS, texts))
            ]
            return (
                Columns(answers, column_first=True)
                if len(answers) > _LONG_LIST
                else Group(*answers)
            )
        case panel.TypedText(text):
            return Text.assemble('> ', (text, 'bold'), ('█', TEAL), overflow='fold')
        case panel.Features(shown, hidden):
            if block.in_rows:
                return _feature_rows(block)
            parts: list[str | tuple[str, str]] = [(f'{block.title}: ', 'dim')]
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
        case panel.Choices(items, at, key):
            table = Table.grid()
            first = at - at % PAGE
            for number, (words, note) in enumerate(items[first : first + PAGE]):
                chosen = first + number == at
                mark = Text('> ' if chosen else '  ', KEY, no_wrap=True)
                words = words if key else f'{number + 1} {words}'
                item = one_line(words), 'bold' if chosen else ''
                table.add_row(mark, Text.assemble(item, (one_line(f'  {note}'), 'dim')))
    return table


def _feature_rows(features: panel.Features) -> RenderableType:
    """Return names and values as a table, in as many columns as fit; long names are wrapped."""
    lengths = [cell_len(name) for name, _ in features.shown]
    width = max((each for each in lengths if each <= _LONG_NAME), default=0)
    rows = [
        Text.assemble(
            set_cell_size(name, max(width, length)), ' ', (value, f'bold {TEAL}'), overflow='fold'
        )
        for (name, value), length in zip(features.shown, lengths)
    ]
    title, hidden = (Text(words, 'dim') for words in (f'{features.title}:', features.hidden))
    table = Columns(rows, padding=(0, 3), equal=True, column_first=True)
    return Group(title, table, *([hidden] if features.hidden else []))


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
