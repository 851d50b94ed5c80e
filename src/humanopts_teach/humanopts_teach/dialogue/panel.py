"""
What the person sees, as plain values: the terminal and the page in the browser only draw them.

Everything is computed here from the published state and the screen. A screen of a new kind
registers with ``panel`` what it shows beside and below the board.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import singledispatch
import math

from humanopts_env.board import Board
from humanopts_env.domains.capabilities import board_of, feature_groups
from humanopts_env.domains.described import can_simulate, published_state
from humanopts_learner.demonstrations import GOAL, METHODS
from humanopts_learner.options.conflicts import NO_START
from humanopts_learner.options.judge import fewest, likely_range
from humanopts_learner.planning.request import MODULAR
from humanopts_learner.summary import Criterion, OptionSummary, RETURN
from humanopts_teach.dialogue.app import App, Screen
from humanopts_teach.dialogue.driving import EXECUTIONS, PlayScreen, WatchScreen
from humanopts_teach.dialogue.entry import (
    ConfirmScreen,
    HelpScreen,
    Item,
    ListScreen,
    PAGE,
    TextScreen,
)
from humanopts_teach.dialogue.keys import Keys
from humanopts_teach.dialogue.study import PageScreen, QuestionScreen
from humanopts_teach.dialogue.teaching import LessonScreen
from humanopts_teach.lesson.requests import LessonView, Phase, World

TARGET = 1 / 3  # of the length of a bar: where a criterion begins to hold
# Where only the chosen features are shown.
_BARE = {Phase.READY, Phase.DEMONSTRATING, Phase.LEARNING, Phase.FINISHED}


class Tone(Enum):
    """What kind of thing a line says."""

    PLAIN = 'plain'
    QUIET = 'quiet'  # read when it is looked for
    NEWS = 'news'  # where we are now
    GOOD = 'good'
    WARNING = 'warning'
    BAD = 'bad'


@dataclass(frozen=True, slots=True)
class Line:
    """A sentence or a few words."""

    text: str
    tone: Tone = Tone.PLAIN
    strong: bool = False
    more: tuple['Line', ...] = ()  # goes on in the same line, with tones of its own


@dataclass(frozen=True, slots=True)
class FeatureShown:
    """A feature that the option depends on."""

    name: str
    value: str  # in the state that is shown; empty: no demonstration is under way


@dataclass(frozen=True, slots=True)
class CriterionShown:
    """A criterion beside what it needs."""

    mark: str
    name: str
    now: str
    needs: str
    tone: Tone
    share: float | None  # of a bar that is filled, 0 to 1; None: it is not measured


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
class ScreenView:
    """Everything that is shown."""

    head: Sequence[str]  # where the person is, in a few words each
    paused: str  # why nothing new can be taught now; empty: it can
    board: Board | None  # None: it has no place on this screen
    panel: Panel
    said: Line
    keys: Keys
    plays: bool = False  # somebody plays on the board, or is about to go on


def view(app: App) -> ScreenView:
    """Return everything that is shown now."""
    screen, world, lesson = app.screen, app.world, app.world.lesson
    shown, board = Panel((Line('Waiting for the game ...'),)), None
    if world.domain is not None:
        shown = panel(screen, app)
        if screen.shows_board:
            bare = isinstance(screen, LessonScreen | ConfirmScreen) and lesson.phase in _BARE
            state = screen.state or world.game.state
            board = Board()
            # Of a domain without rules, a state of the past cannot be drawn again.
            if state and (can_simulate(world.domain) or state == world.game.state):
                drawn = published_state(world.domain, state, world.game.features)
                revealed = lesson.chosen_features if bare else None  # None: all
                board = board_of(world.domain, drawn, revealed)
    showing = isinstance(screen, LessonScreen) and lesson.phase in {
        Phase.DEMONSTRATING,
        Phase.LEARNING,
    }
    plays = showing or isinstance(screen, PlayScreen)
    keys = screen.keys(app)
    return ScreenView(_head(app), lesson.paused, board, shown, _said(app), keys, plays)


def _head(app: App) -> list[str]:
    world, parts = app.world, ['humanopts']
    if world.domain is not None:
        parts.append(world.domain.name)
    if app.participant:
        parts.append(app.participant)
        if world.lesson.session:
            parts.append(f'session {world.lesson.session}')
    if world.holder:
        parts.append('you drive' if world.i_drive else 'another person drives')
    return parts


def _said(app: App) -> Line:
    """Return the last thing that was said, or what the lesson says."""
    if app.world.missing:
        names = ', '.join(app.world.missing)
        return Line(f'Missing: {names}. Everything taught is saved; {app.way_out}.', Tone.BAD)
    if app.message.text:
        return Line(app.message.text, Tone.BAD if app.message.bad else Tone.GOOD)
    return Line(app.world.lesson.text if isinstance(app.screen, LessonScreen) else '', Tone.GOOD)


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
    asked, scale = screen.question, screen.questionnaire
    points = ['●' if value == screen.value else '○' for value in range(1, scale.points + 1)]
    line = Line(f'{asked.low}  {" ".join(points)}  {asked.high}')
    number = Line(f'question {screen.index + 1} of {len(scale.items)}', Tone.QUIET)
    return Panel((Line(asked.text, strong=True), GAP, line, GAP, number))


@panel.register
def _play(screen: PlayScreen, app: App) -> Panel:
    world, game = app.world, app.world.game
    lines = [Line(screen.title, strong=True), Line(screen.text, Tone.QUIET)]
    if isinstance(screen, WatchScreen):
        lines.append(Line(f'Arbitration: {EXECUTIONS[screen.in_force(app)]}.'))
    lines.append(GAP)
    if app.run is not None:
        lines += [Line(f'The machine drives. {app.run_text}', Tone.NEWS), _pace(world)]
        if isinstance(screen, WatchScreen) and screen.in_force(app) in MODULAR:
            # Which option took the last step, where one did and it is known.
            if option := world.acted.get((game.action_publisher_id, game.action_sequence)):
                lines.append(Line(f'{option} won this step.'))
        elif isinstance(screen, WatchScreen) and world.running:
            lines.append(Line(f'It runs: {world.running.replace("action:", "one step ")}'))
    if game.episode:
        lines += [Line(f'episode {game.episode}, step {game.step}'), *_last_step(world)]
        if game.terminated:
            lines.append(Line('The task is over.', Tone.NEWS))
        elif game.truncated:
            lines.append(Line('The episode is over: it is at its step limit.', Tone.WARNING))
    return Panel(lines)


def _pace(world: World) -> Line:
    """Return how fast the machine moves."""
    if world.paused_by:
        return Line('The machine is paused.', Tone.WARNING)
    return Line(f'At most one step every {world.step_period:g} s.', Tone.QUIET)


def _last_step(world: World) -> Iterator[Line]:
    """Yield what the last step did and its reward, where one was taken."""
    game, effect = world.game, world.last_effect
    if game.step:
        text = effect.text if effect is not None else f'last: {game.previous_action}'
        without = effect is not None and not effect.changed
        yield Line(f'{text} (reward {game.reward:g})', Tone.WARNING if without else Tone.PLAIN)


@panel.register
def _lesson(screen: LessonScreen, app: App) -> Panel:
    world, lesson = app.world, app.world.lesson
    title = Line('Teaching: ', more=(Line(lesson.option_name, strong=True),))
    if lesson.phase is Phase.ASKING:
        return Panel((title, GAP, *_question_lines(app, lesson)))
    progress = world.summary_of(lesson.participant, lesson.option_name)
    parts: list[Block] = [title, _standing(world, lesson)]
    if app.run is not None:
        parts += [Line('The machine shows what it learned.', Tone.NEWS), _pace(world)]
    if lesson.phase is Phase.DEMONSTRATING:
        parts += _last_step(world)
    parts.append(_features(app, lesson))
    if lesson.method == GOAL:
        parts.append(Line(f'policy {METHODS[GOAL]}', Tone.QUIET))
    if progress is None or not progress.criteria:
        parts.append(Line('Nothing has been learned yet.'))
    else:
        way = 'goal' if progress.method == GOAL else 'trees'
        parts += [
            Line(f'By {way}, on starts it has not seen:', Tone.QUIET),
            Criteria([_criterion(criterion) for criterion in progress.criteria]),
            _estimate(lesson, progress),
        ]
    return Panel(parts, [] if progress is None else list(_remarks(screen, app, lesson, progress)))


def _question_lines(app: App, lesson: LessonView) -> tuple[Line, ...]:
    """Return the open question, how many there are, and what was answered."""
    names = [feature.name for feature in app.domain.features]
    number = names.index(lesson.question_feature) + 1 if lesson.question_feature in names else 0
    text, which = lesson.question, f'question {number} of {lesson.questions_total}'
    group = app.groups.open_group(app.domain, lesson)
    if group is not None:
        text = f"Does the '{lesson.option_name}' option depend on anything about {group.words}?"
        which = f'If yes, {len(group.features)} features of {group.words} are asked about.'
    yes = ', '.join(map(_plain, lesson.chosen_features)) or 'nothing yet'
    asked = Line(text, strong=True)
    return asked, GAP, Line(which, Tone.QUIET), Line(f'It depends on: {yes}')


def _standing(world: World, lesson: LessonView) -> Line:
    """Return where the lesson stands, and how much was shown."""
    game, shown = world.game, lesson.n_demonstrations + lesson.n_not_here
    where = f'Enter shows start {shown + 1}.'
    if lesson.phase is Phase.DEMONSTRATING:
        where = f'start {shown + 1}, step {game.step}' if game.step else f'next: start {shown + 1}'
    elif lesson.phase is Phase.LEARNING:
        where = 'learning ...'
    elif lesson.phase is Phase.FINISHED:
        where = 'This lesson is finished.'
    elif lesson.paused:
        where = 'The lesson is paused.'
    counts = f'{lesson.n_demonstrations} shown, {lesson.n_not_here} not here'
    shown_so_far = Line(f'  ({counts}; at most {lesson.budget})', Tone.QUIET)
    return Line(where, Tone.NEWS, more=(shown_so_far,))


def _features(app: App, lesson: LessonView) -> Features:
    """Return what the option depends on, with its values in the state that is shown."""
    domain, game = app.domain, app.world.game
    values: list[float] = []
    if game.state and lesson.phase is Phase.DEMONSTRATING:
        state = published_state(domain, game.state, game.features)
        values = domain.feature_values(state).tolist()
    shown = [
        FeatureShown(_plain(feature.name), feature.text(values[index]) if values else '')
        for index, feature in enumerate(domain.features)
        if feature.name in lesson.chosen_features
    ]
    groups = feature_groups(domain)
    unseen = [g.words for g in groups if not set(lesson.chosen_features) & set(g.features)]
    hidden = f'hidden: {", ".join(unseen)}' if unseen else 'all else is hidden'
    return Features(shown, hidden if len(shown) < len(domain.features) else '')


def _plain(name: str) -> str:
    """Return the name of a feature as people read it."""
    return name.replace('_', ' ')


def _criterion(criterion: Criterion) -> CriterionShown:
    value, threshold = criterion.value, criterion.threshold
    if criterion.name == RETURN:
        now = (
            f'{abs(value):.2f} {"worse" if value >= 0 else "better"}' if value is not None else ''
        )
        needs = '?' if threshold is None else f'{threshold:.2f}'
    else:
        now = f'{100 * value:.1f} % wrong' if value is not None else ''
        needs = '?' if threshold is None else f'{100 * threshold:.1f} %'
    share = None
    if value is not None and threshold is not None:
        share = float(value > threshold)
        if threshold > 0:
            share = min(max(TARGET * value / threshold, 0.0), 1.0)
    return CriterionShown(
        '✓' if criterion.met else '?' if criterion.undecided else '·',
        criterion.name,
        now or 'not measured',  # shorter than the verdict: a window has 80 columns
        f'≤ {needs}',
        Tone.GOOD if criterion.met else Tone.WARNING,
        share,
    )


def _estimate(lesson: LessonView, progress: OptionSummary) -> Line:
    """Return how far it is until the criteria hold."""
    if progress.criteria_met:
        return Line(progress.result, Tone.GOOD)
    if progress.n_demonstrations < (least := fewest(lesson.method)):
        return Line(f'Measured from {least} demonstrations on.')
    if progress.obstacles:
        return Line(progress.result if progress.settled else progress.obstacles, Tone.WARNING)
    undecided = [c.name for c in progress.criteria if c.undecided]
    why = f': {", ".join(undecided)} is not yet known well enough' if undecided else ''
    if progress.more_needed < 0 or progress.method == GOAL:
        return Line(f'Too early to say how many more are needed{why}.')
    low, high = likely_range(progress.more_needed)
    return Line(f'Perhaps {low} to {high} more are needed{why}.')


def _remarks(
    screen: LessonScreen, app: App, lesson: LessonView, progress: OptionSummary
) -> Iterator[Line]:
    """Yield what else there is to know of what was learned, and what to press about it."""
    yours, its = progress.mean_return_demonstrations, progress.mean_return_policy
    if not math.isnan(its):
        text = f'on starts it has seen, mean return: yours {yours:.2f}, the option {its:.2f}'
        yield Line(text, Tone.QUIET)
    changed = (progress.method == GOAL) != (lesson.method == GOAL)
    if changed or set(progress.features) != set(lesson.chosen_features):
        yield Line('These are for your earlier answers: show one more.', Tone.WARNING)
    if progress.conflicts:
        more = len(progress.conflicts) - 1
        also = f' (and {more} more)' if more else ''
        yield Line(f'Same situation, shown differently{also}:', Tone.WARNING)
        yield Line(progress.conflicts[0])
    if progress.conflicts and progress.suggested_feature:
        key = screen.questions_key(app)
        how = f' ({key})' if key else ''
        text = f'Add "{_plain(progress.suggested_feature)}"{how}: it separates most of them.'
        yield Line(text, Tone.WARNING)
    elif not progress.suggested_feature and any(NO_START in text for text in progress.conflicts):
        # Some say that it can start here, and some not; where a feature is missing, that is why.
        again_key, list_key = screen.ending_keys(app)
        slip = f'If the last one was a mistake, delete it ({list_key}).'
        text = f'{slip} If the option can start where it ends, press {again_key} before done.'
        yield Line(text, Tone.WARNING)
