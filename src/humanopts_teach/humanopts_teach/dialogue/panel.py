"""
What the person sees, as plain values: the terminal and the page in the browser only draw them.

A screen of a new kind registers with ``panel`` what it shows beside and below the board.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import singledispatch
import math

from humanopts_learner.planning.request import MODULAR
from humanopts_teach.dialogue.app import App, Keys, Screen
from humanopts_teach.dialogue.driving import EXECUTIONS, PlayScreen, WatchScreen
from humanopts_teach.dialogue.entry import (
    ConfirmScreen,
    HelpScreen,
    Item,
    ListScreen,
    PAGE,
    TextScreen,
)
from humanopts_teach.dialogue.study import PageScreen, QuestionScreen
from humanopts_teach.dialogue.teaching import LessonScreen
from humanopts_teach.lesson import presentation
from humanopts_teach.lesson.presentation import CriterionShown, FeatureShown, Line, Tone
from humanopts_teach.lesson.requests import LessonView, OptionStatus, Phase
from humanopts_teach.state_drawing import draw_state, StateDrawing

_BARE = {Phase.READY, Phase.DEMONSTRATING, Phase.LEARNING}  # only chosen features are shown
GAP = Line('')


@dataclass(frozen=True, slots=True)
class TypedText:
    """The line that the person types."""

    text: str


@dataclass(frozen=True, slots=True)
class Choices:
    """Things to pick from."""

    items: Sequence[Item]
    at: int  # index of the one that Enter picks


@dataclass(frozen=True, slots=True)
class KeyList:
    """Keys and what they do, a row each."""

    rows: Sequence[tuple[str, str]]


@dataclass(frozen=True, slots=True)
class Features:
    """What the option depends on, and what is not shown because it does not."""

    shown: Sequence[FeatureShown]
    hidden: str  # empty: nothing is


@dataclass(frozen=True, slots=True)
class Criteria:
    """The criteria of an option, a row each."""

    rows: Sequence[CriterionShown]


@dataclass(frozen=True, slots=True)
class Page:
    """A page to read."""

    text: str  # Markdown


Block = Page | Line | TypedText | Choices | KeyList | Features | Criteria


@dataclass(frozen=True, slots=True)
class Panel:
    """What a screen shows besides the board, from top to bottom."""

    beside: Sequence[Block] = ()
    below: Sequence[Block] = ()  # may stand beside it where that is wide


@dataclass(frozen=True, slots=True)
class View:
    """Everything that is shown."""

    head: Sequence[str]  # where the person is, in a few words each
    paused: str  # why nothing new can be taught now; empty: it can
    board: StateDrawing | None  # None: it has no place on this screen
    panel: Panel
    said: Line
    keys: Keys
    plays: bool = False  # somebody plays on the board, or is about to go on


def view(app: App) -> View:
    """Return everything that is shown now."""
    shown, board = Panel((Line('Waiting for the game ...'),)), None
    if app.world.domain is not None:
        shown = panel(app.screen, app)
        board = _board(app) if app.screen.shows_board else None
    said, keys = _said(app), app.screen.keys(app)
    return View(_head(app), app.world.paused, board, shown, said, keys, _plays(app))


def _plays(app: App) -> bool:
    lesson, screen = app.world.lesson, app.screen
    showing = lesson is not None and lesson.phase in {Phase.DEMONSTRATING, Phase.LEARNING}
    return isinstance(screen, PlayScreen) or (isinstance(screen, LessonScreen) and showing)


def _head(app: App) -> list[str]:
    world, parts = app.world, ['humanopts']
    if world.domain is not None:
        parts.append(world.domain.name)
    if app.participant:
        parts.append(app.participant)
        if world.lesson is not None and world.lesson.session:
            parts.append(f'session {world.lesson.session}')
    if world.holder:
        parts.append('you drive' if world.i_drive else 'another person drives')
    return parts


def _board(app: App) -> StateDrawing:
    game, domain = app.world.game, app.domain
    state = app.screen.state or (game.state if game is not None else '')
    if not state:
        return StateDrawing()
    return draw_state(domain, domain.decode(state), _revealed(app))


def _revealed(app: App) -> Collection[str] | None:
    """Return the features that the board may reveal; None: all."""
    lesson = app.world.lesson
    if (
        isinstance(app.screen, LessonScreen | ConfirmScreen)
        and lesson is not None
        and lesson.phase in _BARE
    ):
        return lesson.chosen_features
    return None


def _said(app: App) -> Line:
    """Return the last thing that was said, or what the lesson says."""
    if app.world.missing:
        names = ', '.join(app.world.missing)
        return Line(f'{names}: not there. Everything taught is saved; {app.way_out}.', Tone.BAD)
    if app.message.text:
        return Line(app.message.text, Tone.BAD if app.message.bad else Tone.GOOD)
    lesson = app.world.lesson
    return Line(lesson.text if isinstance(app.screen, LessonScreen) and lesson else '', Tone.GOOD)


@singledispatch
def panel(screen: Screen, app: App) -> Panel:
    """Return what a screen shows besides the board."""
    return Panel()


@panel.register
def _text(screen: TextScreen, app: App) -> Panel:
    title, explanation = Line(screen.title, strong=True), Line(screen.explanation, Tone.QUIET)
    return Panel((title, GAP, TypedText(screen.typed), GAP, explanation))


@panel.register
def _list(screen: ListScreen, app: App) -> Panel:
    title, n_states = Line(screen.title, strong=True), len(screen.items[screen.at].states)
    step = Line(f'board: step {screen.step} of {n_states - 1}', Tone.QUIET)
    choices = Choices(screen.items, screen.at)
    more = Line(f'{screen.at + 1} of {len(screen.items)}', Tone.QUIET)
    along = [step] if n_states > 1 else []
    return Panel((title, *along, GAP, choices, *([more] if len(screen.items) > PAGE else [])))


@panel.register
def _confirm(screen: ConfirmScreen, app: App) -> Panel:
    return Panel((Line(screen.question, strong=True),))


@panel.register
def _help(screen: HelpScreen, app: App) -> Panel:
    return Panel((Line(screen.title, strong=True), KeyList(screen.table)))


@panel.register
def _page(screen: PageScreen, app: App) -> Panel:
    return Panel((Page(screen.text),))


@panel.register
def _question(screen: QuestionScreen, app: App) -> Panel:
    asked, count = screen.question, len(screen.questions)
    points = ['●' if value == screen.value else '○' for value in range(1, asked.points + 1)]
    scale = Line(f'{asked.low}  {" ".join(points)}  {asked.high}')
    place = Line(f'question {screen.place + 1} of {count}', Tone.QUIET)
    return Panel((Line(asked.text, strong=True), GAP, scale, GAP, place))


@panel.register
def _play(screen: PlayScreen, app: App) -> Panel:
    game, running = app.world.game, app.run is not None
    lines = [Line(screen.title, strong=True), Line(screen.text, Tone.QUIET)]
    if isinstance(screen, WatchScreen):
        lines.append(Line(f'Arbitration: {EXECUTIONS[screen.in_force(app)]}.'))
    lines.append(GAP)
    if running:
        lines.append(Line(f'The machine drives. {app.run_text}', Tone.NEWS))
        lines.append(presentation.pace(app.world))
        if isinstance(screen, WatchScreen) and screen.in_force(app) in MODULAR:
            lines += _given(presentation.winner(app.world))
        elif isinstance(screen, WatchScreen) and app.world.running:
            lines.append(Line(f'It runs: {app.world.running.replace("action:", "one step ")}'))
    if game is not None and game.episode:
        lines.append(Line(f'episode {game.episode}, step {game.step}'))
        lines += _given(presentation.last_step(app.world), presentation.ending(app.world))
    return Panel(lines)


@panel.register
def _lesson(screen: LessonScreen, app: App) -> Panel:
    lesson = app.world.lesson
    if lesson is None:
        return Panel((GAP,))
    title = Line('Teaching: ', more=(Line(lesson.option_name, strong=True),))
    if lesson.phase is Phase.ASKING:
        group = app.groups.open_group(app.domain, lesson)
        asked, *rest = presentation.question(app.domain, lesson, group)
        return Panel((title, GAP, asked, GAP, *rest))
    progress = app.world.progress_of(lesson.participant, lesson.option_name)
    parts: list[Block] = [title, presentation.place(app.world, lesson)]
    if app.run is not None:
        parts.append(Line('The machine shows what it learned.', Tone.NEWS))
        parts.append(presentation.pace(app.world))
    if lesson.phase is Phase.DEMONSTRATING:
        parts += _given(presentation.last_step(app.world))
    features = presentation.features(app.world, lesson)
    parts.append(Features(features, presentation.hidden(app.domain, lesson)))
    parts += _given(presentation.planned(lesson))
    parts += _criteria(lesson, progress)
    if progress is None:
        return Panel(parts)
    below = _given(
        None if math.isnan(progress.mean_return_policy) else presentation.returns(progress),
        presentation.outdated(lesson, progress),
        *presentation.conflicts(progress, screen.questions_key(app)),
        presentation.ends(progress, *screen.ending_keys(app)),
    )
    return Panel(parts, below)


def _criteria(lesson: LessonView, progress: OptionStatus | None) -> list[Block]:
    if progress is None or not progress.criteria:
        return [Line('Nothing is learned yet.')]
    rows = Criteria(presentation.criteria(progress))
    return [presentation.heading(progress), rows, presentation.estimate(lesson, progress)]


def _given(*lines: Line | None) -> list[Line]:
    return [line for line in lines if line is not None]
