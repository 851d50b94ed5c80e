"""What stands beside the board, as rich renderables."""

from collections.abc import Sequence
from functools import singledispatch
import math

from humanopts_learner.demonstrations import GOAL, METHODS
from humanopts_learner.options.conflicts import NO_START
from humanopts_learner.options.criteria import Criterion, fewest
from humanopts_teach.lesson.requests import LessonView, OptionStatus, Phase
from humanopts_teach.terminal.app import App, Screen
from humanopts_teach.terminal.driving import EXECUTIONS, PlayScreen, WatchScreen
from humanopts_teach.terminal.entry import ConfirmScreen, HelpScreen, ListScreen, TextScreen
from humanopts_teach.terminal.teaching import LessonScreen
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text


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
        lines.append(Text(f'The machine drives. {app.run_text}', 'bright_cyan'))
        if isinstance(screen, WatchScreen) and app.world.running:
            lines.append(Text(f'It runs: {app.world.running.replace("action:", "one step ")}'))
    if game is not None and game.episode:
        lines.append(Text(f'episode {game.episode}, step {game.step}'))
        if game.step:
            lines.append(Text(f'last: {game.previous_action}, reward {game.reward:g}'))
        if game.terminated:
            lines.append(Text('The task is done.', 'bold green'))
        elif game.truncated:
            lines.append(Text('The episode is over: it is at its step limit.', 'yellow'))
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
    parts: list[RenderableType] = [title, _where(lesson, app), _features(lesson, app)]
    if lesson.method == GOAL:
        parts.append(Text(f'policy {METHODS[GOAL]}', 'dim'))
    parts += _criteria(lesson, progress)
    if progress is not None:
        parts += _conflicts(progress, screen.questions_key(app))
        parts += _ends(progress, *screen.ending_keys(app))
    return Group(*parts)


def _question(lesson: LessonView, app: App) -> list[RenderableType]:
    names = [feature.name for feature in app.domain.features]
    number = names.index(lesson.question_feature) + 1 if lesson.question_feature in names else 0
    yes = ', '.join(map(_plain, lesson.chosen_features)) or 'nothing yet'
    return [
        Text(),
        Text(lesson.question, 'bold'),
        Text(),
        Text(f'question {number} of {lesson.questions_total}', 'dim'),
        Text(f'It depends on: {yes}'),
    ]


def _where(lesson: LessonView, app: App) -> Text:
    game = app.world.game
    shown = lesson.n_demonstrations + lesson.n_not_here
    where = f'Enter shows start {shown + 1}.'
    if lesson.phase is Phase.DEMONSTRATING and game is not None:
        where = f'start {shown + 1}, step {game.step}' if game.step else f'next: start {shown + 1}'
    elif lesson.phase is Phase.LEARNING:
        where = 'learning ...'
    elif lesson.phase is Phase.FINISHED:
        where = 'This lesson is finished.'
    elif lesson.paused:
        where = 'The lesson is paused.'
    counts = (
        f'{lesson.n_demonstrations} shown, {lesson.n_not_here} not here; at most {lesson.budget}'
    )
    return Text.assemble((where, 'bright_cyan'), (f'  ({counts})', 'dim'))


def _features(lesson: LessonView, app: App) -> Text:
    game, text = app.world.game, Text('depends on: ', 'dim')
    values: Sequence[int] = []
    if game is not None and game.state and lesson.phase is Phase.DEMONSTRATING:
        values = app.domain.feature_values(app.domain.decode(game.state)).tolist()
    shown = [f for f in enumerate(app.domain.features) if f[1].name in lesson.chosen_features]
    for number, (index, feature) in enumerate(shown):
        text.append(', ' if number else '', 'dim')
        text.append(_plain(feature.name), 'not dim')
        if len(values):
            text.append(f' {feature.values[values[index]]}', 'not dim bold bright_cyan')
    return text


def _criteria(lesson: LessonView, progress: OptionStatus | None) -> list[RenderableType]:
    if progress is None or not progress.criteria:
        return [Text('Nothing is learned yet.')]
    table = Table.grid(padding=(0, 2, 0, 0))
    table.add_row('', *(Text(head, 'dim', no_wrap=True) for head in ('learned', 'now', 'needs')))
    for criterion in progress.criteria:
        table.add_row(*_criterion(criterion))
    parts: list[RenderableType] = [table, _estimate(lesson, progress)]
    if not math.isnan(progress.mean_return_policy):
        yours, its = progress.mean_return_demonstrations, progress.mean_return_policy
        text = f'mean return from your starts: yours {yours:.2f}, the option {its:.2f}'
        parts.append(Text(text, 'dim'))
    changed = (progress.method == GOAL) != (lesson.method == GOAL)
    if changed or set(progress.features) != set(lesson.chosen_features):
        parts.append(Text('These are for the earlier answers: show one more.', 'yellow'))
    return parts


def _criterion(criterion: Criterion) -> list[Text]:
    error = criterion.name != 'return'

    def number(value: float) -> str:
        if error:
            return f'{100 * value:.1f} % wrong'
        return f'{abs(value):.2f} {"worse" if value >= 0 else "better"}'

    style = 'green' if criterion.met else 'yellow'
    now = 'not yet measurable' if criterion.value is None else number(criterion.value)
    return [
        Text('✓' if criterion.met else '?' if criterion.undecided else '·', style),
        Text(criterion.name),
        Text(now, style),
        Text(f'≤ {number(criterion.threshold)}', 'dim'),
    ]


def _estimate(lesson: LessonView, progress: OptionStatus) -> Text:
    more = progress.more_needed
    if progress.criteria_met:
        goes_on = lesson.phase in {Phase.READY, Phase.DEMONSTRATING}
        still = goes_on and set(progress.features) == set(lesson.chosen_features)
        but = ', but from some starts it still fails.' if still else '.'
        return Text(f'All criteria hold{but}', 'bold green')
    if progress.n_demonstrations < (least := fewest(lesson.method)):
        return Text(f'Measured from {least} demonstrations on.')
    undecided = [c.name for c in progress.criteria if c.undecided]
    why = f': {", ".join(undecided)} is not yet known well enough' if undecided else ''
    if more < 0:
        return Text(f'How many more it takes cannot be told yet{why}.')
    return Text(f'About {more} more {"is" if more == 1 else "are"} needed (an estimate){why}.')


def _conflicts(progress: OptionStatus, key: str) -> list[RenderableType]:
    """Return a situation that was answered differently, and what to press about it."""
    if not progress.conflicts:
        return []
    more = len(progress.conflicts) - 1
    head = f'Alike, but shown differently{f" (and {more} more)" if more else ""}:'
    lines: list[RenderableType] = [Text(head, 'yellow'), Text(progress.conflicts[0])]
    if progress.suggested_feature:
        name = _plain(progress.suggested_feature)
        how = f' ({key})' if key else ''
        lines.append(Text(f'Add "{name}"{how}: it tells most apart.', 'yellow'))
    return lines


def _ends(progress: OptionStatus, again: str, undo: str) -> list[RenderableType]:
    """Return what may be missing where some say that it can start here, and some not."""
    if progress.suggested_feature or not any(NO_START in text for text in progress.conflicts):
        return []  # where a feature is missing, that is why
    slip = f'If the last one was a slip, press {undo}.'
    return [Text(f'{slip} Where an end can be a start, press {again} before done.', 'yellow')]


def _plain(name: str) -> str:
    return name.replace('_', ' ')
