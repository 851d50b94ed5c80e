"""What stands beside the board, as rich renderables."""

from functools import singledispatch
import math

from humanopts_teach.lesson import presentation
from humanopts_teach.lesson.presentation import Line, Tone
from humanopts_teach.lesson.requests import LessonView, OptionStatus, Phase
from humanopts_teach.terminal.app import App, Screen
from humanopts_teach.terminal.driving import EXECUTIONS, PlayScreen, WatchScreen
from humanopts_teach.terminal.entry import ConfirmScreen, HelpScreen, ListScreen, TextScreen
from humanopts_teach.terminal.teaching import LessonScreen
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

STYLES = {
    Tone.PLAIN: '',
    Tone.QUIET: 'dim',
    Tone.NEWS: 'bright_cyan',
    Tone.GOOD: 'green',
    Tone.WARNING: 'yellow',
}


@singledispatch
def panel(screen: Screen, app: App) -> RenderableType:
    """Return what a screen shows beside the board."""
    return Text()


@panel.register
def _text(screen: TextScreen, app: App) -> RenderableType:
    return Group(
        Text(screen.title, 'bold'),
        Text(),
        Text.assemble('> ', (screen.typed, 'bold bright_white'), ('█', 'bright_cyan')),
        Text(),
        Text(screen.explanation, 'dim'),
    )


@panel.register
def _list(screen: ListScreen, app: App) -> RenderableType:
    lines = [Text(screen.title, 'bold'), Text()]
    for number, item in enumerate(screen.items):
        chosen = number == screen.at
        lines.append(
            Text.assemble(
                ('> ' if chosen else '  ', 'bold bright_cyan'),
                (f'{number + 1} {item.text}', 'bold' if chosen else ''),
                (f'  {item.note}', 'dim'),
                overflow='ellipsis',
                no_wrap=True,
            )
        )
    return Group(*lines)


@panel.register
def _confirm(screen: ConfirmScreen, app: App) -> RenderableType:
    return Text(screen.question, 'bold')


@panel.register
def _help(screen: HelpScreen, app: App) -> RenderableType:
    table = Table.grid(padding=(0, 2))
    for key, words in screen.table:
        table.add_row(Text(key, 'bold bright_cyan', justify='right'), Text(words))
    return Group(Text('Keys', 'bold'), table)


@panel.register
def _play(screen: PlayScreen, app: App) -> RenderableType:
    game, running = app.world.game, app.run is not None
    lines = [Text(screen.title, 'bold'), Text(screen.text, 'dim')]
    if isinstance(screen, WatchScreen):
        lines.append(Text(f'Arbitration: {EXECUTIONS[screen.in_force(app)]}.'))
    lines.append(Text())
    if running:
        lines.append(Text(f'The machine drives. {app.run_text}', STYLES[Tone.NEWS]))
        if isinstance(screen, WatchScreen) and app.world.running:
            lines.append(Text(f'It runs: {app.world.running.replace("action:", "one step ")}'))
    if game is not None and game.episode:
        lines.append(Text(f'episode {game.episode}, step {game.step}'))
        lines += _lines(presentation.last_step(app.world), presentation.ending(app.world))
    return Group(*lines)


@panel.register
def _lesson(screen: LessonScreen, app: App) -> RenderableType:
    lesson = app.world.lesson
    if lesson is None:
        return Text()
    title = Text.assemble('Teaching: ', (lesson.option_name, 'bold bright_white'))
    if lesson.phase is Phase.ASKING:
        return Group(title, *_question(lesson, app))
    progress = app.world.progress_of(lesson.participant, lesson.option_name)
    parts: list[RenderableType] = [title, _where(lesson, app)]
    if lesson.phase is Phase.DEMONSTRATING:
        parts += _lines(presentation.last_step(app.world))
    parts += [_features(lesson, app), *_lines(presentation.planned(lesson))]
    parts += _criteria(lesson, progress)
    if progress is not None:
        parts += _lines(*presentation.conflicts(progress, screen.questions_key(app)))
        parts += _lines(presentation.ends(progress, *screen.ending_keys(app)))
    return Group(*parts)


def _lines(*lines: Line | None) -> list[Text]:
    return [Text(line.text, STYLES[line.tone]) for line in lines if line is not None]


def _question(lesson: LessonView, app: App) -> list[RenderableType]:
    asked, *rest = presentation.question(app.domain, lesson)
    return [Text(), Text(asked.text, 'bold'), Text(), *_lines(*rest)]


def _where(lesson: LessonView, app: App) -> Text:
    (where,) = _lines(presentation.place(app.world, lesson))
    return where.append(f'  ({presentation.counts(lesson)})', 'not bold dim')


def _features(lesson: LessonView, app: App) -> Text:
    text = Text('depends on: ', 'dim')
    for number, feature in enumerate(presentation.features(app.world, lesson)):
        text.append(', ' if number else '', 'dim')
        text.append(feature.name, 'not dim')
        if feature.value:
            text.append(f' {feature.value}', 'not dim bold bright_cyan')
    return text


def _criteria(lesson: LessonView, progress: OptionStatus | None) -> list[RenderableType]:
    if progress is None or not progress.criteria:
        return [Text('Nothing is learned yet.')]
    table = Table.grid(padding=(0, 2, 0, 0))
    table.add_row('', *(Text(head, 'dim', no_wrap=True) for head in ('learned', 'now', 'needs')))
    for shown in presentation.criteria(progress):
        style = STYLES[shown.tone]
        table.add_row(
            Text(shown.mark, style),
            Text(shown.name),
            Text(shown.now, style),
            Text(shown.needs, 'dim'),
        )
    parts: list[RenderableType] = [table, *_lines(presentation.estimate(lesson, progress))]
    if not math.isnan(progress.mean_return_policy):
        parts += _lines(presentation.returns(progress))
    return parts + _lines(presentation.outdated(lesson, progress))
