"""The whole screen as lines of a given size."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from io import StringIO
from typing import Any, Literal

from humanopts_env.colours import GREEN, RED
from humanopts_env.domains.base import Domain
from humanopts_teach.dialogue.app import App
from humanopts_teach.dialogue.entry import ConfirmScreen, HelpScreen
from humanopts_teach.dialogue.teaching import LessonScreen
from humanopts_teach.lesson.requests import Phase
from humanopts_teach.terminal.panels import KEY, panel
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
BAD = f'bold {RED}'
_BARE = {Phase.READY, Phase.DEMONSTRATING, Phase.LEARNING}  # only chosen features are shown


def frame(app: App, width: int, height: int, colours: Colours | None = None) -> list[str]:
    """
    Return the screen as ``height`` lines, each ``width`` cells wide at most.

    :param colours: as rich names what the terminal can do; None: plain text.
    """
    if width < SMALLEST[0] or height < SMALLEST[1]:
        return fit(lines_of(_too_small(width, height), width, colours), height)
    bottom = lines_of(_foot(app, width), width, colours)
    gap = [Text()] if height > _ROOMY else []
    top = lines_of(
        Group(_head(app, width), *_pause(app, height), *gap, _middle(app, width)), width, colours
    )
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


def _head(app: App, width: int) -> Text:
    world = app.world
    parts = ['humanopts']
    if world.domain is not None:
        parts.append(world.domain.name)
    if app.participant:
        parts.append(app.participant)
        if world.lesson is not None and world.lesson.session:
            parts.append(f'session {world.lesson.session}')
    if world.holder:
        parts.append('you drive' if world.i_drive else 'another person drives')
    return Text(set_cell_size(f' {" · ".join(parts)}', width), 'reverse')


def _pause(app: App, height: int) -> list[RenderableType]:
    """Return why nothing new can be taught now; in a low window its beginning."""
    if not app.world.paused:
        return []
    why = Text.assemble(('PAUSED: ', 'bold'), app.world.paused, overflow='ellipsis')
    why.no_wrap = height < _ROOMY
    return [Padding(why, (0, 1), style=f'color(231) on {RED}')]


def _middle(app: App, width: int) -> RenderableType:
    if app.world.domain is None:
        return Text('Waiting for the game ...')
    shown = panel(app.screen, app)
    if isinstance(app.screen, HelpScreen):
        return shown.beside
    board, notes = _board(app)
    board_width = max(cell_len(line) for line in board.plain.split('\n'))
    table = Table.grid(padding=(0, 3, 0, 0), expand=True)
    table.add_column(width=board_width, no_wrap=True)
    table.add_column(ratio=1)
    if width - board_width < _WIDE_BESIDE:
        table.add_row(board, shown.beside)
        return Group(table, notes, shown.below)
    table.add_row(board, Group(shown.beside, shown.below))
    return Group(table, notes)


def _board(app: App) -> tuple[Text, Text]:
    """Return the board, and the lines below it, which may be wider."""
    game, domain = app.world.game, app.domain
    if game is None or not game.state:
        return Text(), Text()
    return board_text(domain, domain.decode(game.state), _shown(app))


def board_text(
    domain: Domain[Any], state: Any, shown: Collection[str] | None = None
) -> tuple[Text, Text]:
    """
    Draw a state in the domain's colours.

    :param shown: names of the features that may be revealed; None: all.
    :return: the board, and the lines below it, which may be wider.
    """
    lines = domain.render(state, shown).split('\n')
    width = cell_len(lines[0])
    end = next((n for n, line in enumerate(lines) if cell_len(line) != width), len(lines))
    styles = domain.glyph_styles
    return _coloured(lines[:end], styles), _coloured(lines[end:], styles, alone=True)


def _coloured(lines: Sequence[str], styles: Mapping[str, str], *, alone: bool = False) -> Text:
    """
    Return the lines with the domain's colours.

    :param alone: colour only characters that are no part of a word.
    """
    plain = '\n'.join(lines)
    text = Text(plain)
    around = f' {plain} '
    for at, character in enumerate(plain):
        in_word = alone and (around[at].isalpha() or around[at + 2].isalpha())
        if character in styles and not in_word:
            text.stylize(styles[character], at, at + 1)
    return text


def _shown(app: App) -> Collection[str] | None:
    """Return the features that the board may reveal; None: all."""
    lesson = app.world.lesson
    if (
        isinstance(app.screen, LessonScreen | ConfirmScreen)
        and lesson is not None
        and lesson.phase in _BARE
    ):
        return lesson.chosen_features
    return None


def _foot(app: App, width: int) -> Group:
    return Group(Text('─' * width, 'dim'), _said(app), *key_bar(app.screen.keys(app), width))


def key_bar(keys: Sequence[tuple[str, str]], width: int) -> list[Text]:
    """Return keys and what they do in as few lines as they fit in, none broken in two."""
    lines = [Text()]
    for key, words in keys:
        entry = Text.assemble((key, KEY), ' ', words)
        if lines[-1].cell_len + 2 + entry.cell_len > width:
            lines.append(Text())
        lines[-1].append('  ' if lines[-1].plain else '').append_text(entry)
    return lines


def _said(app: App) -> Text:
    if app.world.missing:
        names = ', '.join(app.world.missing)
        return Text(f'{names}: not there. Everything taught is saved; Ctrl-C quits.', BAD)
    if app.message.text:
        return Text(app.message.text, BAD if app.message.bad else GREEN)
    lesson = app.world.lesson
    return Text(lesson.text if isinstance(app.screen, LessonScreen) and lesson else '', GREEN)
