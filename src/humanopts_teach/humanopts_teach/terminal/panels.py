"""What stands beside and below the board, as rich renderables."""

from dataclasses import dataclass, field
from functools import singledispatch
import math

from humanopts_env.colours import GREEN, ORANGE, TEAL
from humanopts_teach.dialogue.app import App, Screen
from humanopts_teach.dialogue.driving import EXECUTIONS, PlayScreen, WatchScreen
from humanopts_teach.dialogue.entry import ConfirmScreen, HelpScreen, ListScreen, TextScreen
from humanopts_teach.dialogue.teaching import LessonScreen
from humanopts_teach.lesson import presentation
from humanopts_teach.lesson.presentation import Line, Tone
from humanopts_teach.lesson.requests import LessonView, OptionStatus, Phase
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

KEY = f'bold {TEAL}'  # a key that can be pressed
STYLES = {
    Tone.PLAIN: '',
    Tone.QUIET: 'dim',
    Tone.NEWS: TEAL,
    Tone.GOOD: GREEN,
    Tone.WARNING: ORANGE,
}


@dataclass(frozen=True)
class Panel:
    """What a screen shows besides the board."""

    beside: RenderableType
    below: RenderableType = field(default_factory=Group)  # may stand beside it where that is wide


@singledispatch
def panel(screen: Screen, app: App) -> Panel:
    """Return what a screen shows besides the board."""
    return Panel(Text())


@panel.register
def _text(screen: TextScreen, app: App) -> Panel:
    typed = Text.assemble('> ', (screen.typed, 'bold'), ('█', TEAL), overflow='fold')
    explanation = Text(screen.explanation, 'dim')
    return Panel(Group(Text(screen.title, 'bold'), Text(), typed, Text(), explanation))


@panel.register
def _list(screen: ListScreen, app: App) -> Panel:
    table = Table.grid()
    for number, item in enumerate(screen.items):
        chosen = number == screen.at
        mark = Text('> ' if chosen else '  ', f'bold {TEAL}', no_wrap=True)
        name = (f'{number + 1} {item.text}', 'bold' if chosen else '')
        table.add_row(mark, Text.assemble(name, (f'  {item.note}', 'dim')))
    return Panel(Group(Text(screen.title, 'bold'), Text(), table))


@panel.register
def _confirm(screen: ConfirmScreen, app: App) -> Panel:
    return Panel(Text(screen.question, 'bold'))


@panel.register
def _help(screen: HelpScreen, app: App) -> Panel:
    table = Table.grid(padding=(0, 2))
    for key, words in screen.table:
        table.add_row(Text(key, KEY, justify='right'), Text(words))
    return Panel(Group(Text('Keys', 'bold'), table))


@panel.register
def _play(screen: PlayScreen, app: App) -> Panel:
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
    return Panel(Group(*lines))


@panel.register
def _lesson(screen: LessonScreen, app: App) -> Panel:
    lesson = app.world.lesson
    if lesson is None:
        return Panel(Text())
    title = Text.assemble('Teaching: ', (lesson.option_name, 'bold'))
    if lesson.phase is Phase.ASKING:
        return Panel(Group(title, *_question(lesson, app)))
    progress = app.world.progress_of(lesson.participant, lesson.option_name)
    parts: list[RenderableType] = [title, _where(lesson, app)]
    if lesson.phase is Phase.DEMONSTRATING:
        parts += _lines(presentation.last_step(app.world))
    parts += [_features(lesson, app), *_lines(presentation.planned(lesson))]
    parts += _criteria(lesson, progress)
    if progress is None:
        return Panel(Group(*parts))
    below = [] if math.isnan(progress.mean_return_policy) else [presentation.returns(progress)]
    return Panel(
        Group(*parts),
        Group(
            *_lines(
                *below,
                presentation.outdated(lesson, progress),
                *presentation.conflicts(progress, screen.questions_key(app)),
                presentation.ends(progress, *screen.ending_keys(app)),
            )
        ),
    )


def _lines(*lines: Line | None) -> list[Text]:
    return [Text(line.text, STYLES[line.tone]) for line in lines if line is not None]


def _question(lesson: LessonView, app: App) -> list[RenderableType]:
    group = app.groups.open_group(app.domain, lesson)
    asked, *rest = presentation.question(app.domain, lesson, group)
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
            text.append(f' {feature.value}', f'not dim bold {TEAL}')
    if unseen := presentation.hidden(app.domain, lesson):
        text.append(f'; {unseen}', 'dim')
    return text


def _criteria(lesson: LessonView, progress: OptionStatus | None) -> list[RenderableType]:
    if progress is None or not progress.criteria:
        return [Text('Nothing is learned yet.')]
    table = Table.grid(padding=(0, 2, 0, 0))
    for shown in presentation.criteria(progress):
        style = STYLES[shown.tone]
        name = Text(f'{shown.mark} {shown.name}')
        name.stylize(style, 0, 1)
        table.add_row(name, Text(shown.now, style), Text(shown.needs, 'dim'))
    (heading,) = _lines(presentation.heading(progress))
    return [heading, table, *_lines(presentation.estimate(lesson, progress))]
