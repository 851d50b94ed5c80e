"""Navigation between screens: sign-in, main menu, choice of an option."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial

from humanopts_env.domains.base import Feature, FeatureKind, is_enumerable
from humanopts_env.domains.described import can_simulate
from humanopts_env.domains.replayed_domain import ReplayedDomain
from humanopts_learner.demonstrations import FOREST, GOAL, METHODS, TREES
from humanopts_learner.planning.abstraction import Column
from humanopts_learner.planning.request import (
    HUMAN,
    HUMAN_AND_PRIMITIVE,
    PlanError,
    PRIMITIVE,
    Q,
)
from humanopts_teach.dialogue.app import App, EARLIEST
from humanopts_teach.dialogue.driving import LEARNING_EPISODES, PlayScreen, RunScreen, WatchScreen
from humanopts_teach.dialogue.entry import confirm, end, Item, ListScreen, Notice, TextScreen
from humanopts_teach.dialogue.keys import Command, Do, ESCAPE
from humanopts_teach.dialogue.panel import Line
from humanopts_teach.dialogue.segments import WholeTaskScreen
from humanopts_teach.dialogue.teaching import LessonScreen
from humanopts_teach.language import _, translated
from humanopts_teach.lesson.requests import (
    Answer,
    BeginDemonstration,
    ChangeOption,
    DefineOption,
    EndDemonstration,
    ListOptions,
    OpenSession,
    Phase,
    SetControl,
    UNKNOWN,
    Verdict,
)


@dataclass
class OpeningScreen(TextScreen):
    """
    The first screen, which asks for the participant code.

    :ivar known: submit the proposed code as soon as the lesson is available; the person is asked
        only if it is refused.
    """

    known: bool = False
    claims_lesson = True

    def tick(self, app: App) -> None:
        """Submit a known code, once."""
        if self.known and app.world.lesson is not UNKNOWN:
            self.known = False
            self.submit(self.typed, app)


def opening(participant: str, *, ask: bool = True) -> OpeningScreen:
    """
    Return the first screen.

    :param participant: participant code to propose or use.
    :param ask: whether to ask the person to confirm the code.
    """
    return OpeningScreen(
        _('Who is teaching?'),
        _('Your code keeps your options apart from those of others. Enter accepts it.'),
        participant,
        _enter,
        known=not ask,
    )


def _enter(code: str, app: App) -> None:
    lesson = app.world.lesson
    demonstrating = lesson.phase is Phase.DEMONSTRATING
    app.claim_lesson(code, _displaced())
    # A disconnected terminal left an unfinished demonstration; its owner continues it.
    if demonstrating and lesson.participant == code:
        app.known_options = (lesson.option_name,)
        to_lesson(app)
    elif demonstrating and not app.world.holder:
        question = _(
            '{participant} has a demonstration under way, but is not in control now. '
            '{participant} may still be there. Discard the demonstration?'
        ).format(participant=lesson.participant)
        app.show(confirm(question, partial(_take_over, lesson.episode), app.screen.again))
    else:
        _open(app)


def _displaced() -> Notice:
    """Return the screen shown after the lesson was taken over; only t reclaims it."""
    choices = [
        Command('t', _('take it back'), lambda app: _enter(app.participant, app)),
        Command([ESCAPE], _('menu'), to_menu),
    ]
    question = Line(_('The lesson is no longer yours. Take it back?'), strong=True)
    return Notice([question], choices, claims_lesson=True)


def _take_over(episode: int, app: App) -> None:
    """Discard another person's unfinished demonstration, unless it has changed; then sign in."""
    lesson = app.world.lesson
    demonstrating = lesson.phase is Phase.DEMONSTRATING and lesson.episode == episode
    if demonstrating and not app.world.holder:
        app.ask(EndDemonstration(Verdict.DISCARD, episode, 0))
    _open(app)


def _open(app: App) -> None:
    app.ask(OpenSession(app.participant), then=partial(_know, app))


def _know(app: App, answer: Answer) -> None:
    """Store the known options from the answer, then show the menu."""
    app.known_options = answer.known_options
    to_menu(app)


def to_menu(app: App) -> None:
    """Release control, except of a robot, and show the main menu."""
    if app.world.in_control and not app.world.robot:
        app.ask(SetControl(hold=False))
    app.next_start = ''
    known = len(app.known_options)
    items = _items(app.given_options, _define, app)
    if not items:
        items = [
            Item(_('Teach a new option'), _('name it, answer questions, show it'), _name_option)
        ]
        if known:
            items.append(
                Item(
                    _('Continue teaching an option'),
                    _('{count} so far').format(count=known),
                    _choose_known,
                )
            )
    items += [
        Item(_('Run a taught option'), _('the machine runs it, you watch'), _list_taught),
        Item(_('Watch the machine play'), _('it plans, then plays'), _choose_plan),
        Item(_('Drive freely'), _('get to know the game and the keys'), _play),
    ]
    if known and not app.given_options:
        note = _('rename or delete it, or learn it in another way')
        choose = partial(_choose, _('Change which option?'), _change)
        items.append(Item(_('Change an option'), note, choose))
    if not app.in_study:
        items.append(Item(_('Play the whole task once'), _('then name its parts'), _play_whole))
    text, note = app.leaving
    app.show(ListScreen(_('What next?'), [*items, Item(_(text), _(note), _finish)]))


def _finish(app: App) -> None:
    """Leave the dialogue; ask for confirmation if something is unfinished."""
    if question := app.leaving_question():
        app.show(replace(confirm(question, end, to_menu), earliest=EARLIEST))
    else:
        end(app)


def to_lesson(app: App) -> None:
    """Show the lesson in its current phase."""
    app.groups.forget()
    app.show(LessonScreen(to_menu, to_run))


def to_run(option_name: str, app: App) -> None:
    """Show the screen that runs one option."""
    app.show(RunScreen(to_menu, option_name=option_name, correct=correct))


def correct(option_name: str, app: App) -> None:
    """Take over from a running option, and begin a demonstration in the current state."""

    def begin(answer: Answer) -> None:
        app.ask(BeginDemonstration('' if app.world.robot else app.world.game.state))

    to_lesson(app)
    app.ask(SetControl(hold=True), DefineOption(option_name), then=begin)


def _name_option(app: App) -> None:
    explanation = _('In your own words: go to ..., avoid ..., fetch ...')
    app.show(TextScreen(_('What is the option called?'), explanation, '', _define, to_menu))


def _define(name: str, app: App, method: str = '') -> None:
    """Create an option, or resume it, and show its lesson."""

    def defined(answer: Answer) -> None:
        if name not in app.known_options:
            app.known_options = (*app.known_options, name)
        to_lesson(app)

    app.ask(DefineOption(name, method=method), then=defined)


def _items(names: Iterable[str], choose: Callable[[str, App], object], app: App) -> list[Item]:
    """Return a list item for each option, with its progress."""
    items, lesson = [], app.world.lesson
    stuck = dict(zip(lesson.stuck_options, lesson.stuck_games))
    for name in names:
        progress, note = app.world.summary_of(app.participant, name), _('nothing learned yet')
        if progress is not None:
            status = progress.status.partition(',')[0]  # without the confidence limit
            note = _('{shown} shown, {refused} not here; {status}').format(
                shown=progress.n_demonstrations,
                refused=progress.n_not_here,
                status=translated(status),
            )
        if count := stuck.get(name):
            note += _('; a plan got stuck here in {count} of {most} games').format(
                count=count, most=lesson.trial_games
            )
        items.append(Item(name, note, partial(choose, name)))
    return items


def _choose(title: str, choose: Callable[[str, App], object], app: App) -> None:
    app.show(ListScreen(title, _items(app.known_options, choose, app), to_menu))


def _choose_known(app: App) -> None:
    items = [*_items(app.known_options, _define, app), Item(_('A new option'), '', _name_option)]
    app.show(ListScreen(_('Continue with which option?'), items, to_menu))


def _change(name: str, app: App) -> None:
    items = [
        Item(_('Rename it'), _('its demonstrations are kept'), partial(_rename, name)),
        Item(_('Delete it'), _('its demonstrations no longer count'), partial(_delete, name)),
    ]
    progress = app.world.summary_of(app.participant, name)
    other = GOAL if is_enumerable(app.domain) else FOREST
    if progress is not None and progress.method != TREES:
        other = TREES
    note = _('{how}, from the next demonstration on').format(how=translated(METHODS[other]))
    items.append(
        Item(
            _('Learn it by {method}').format(method=translated(other)),
            note,
            partial(_define, name, method=other),
        )
    )
    app.show(ListScreen(name, items, partial(_choose, _('Change which option?'), _change)))


def _rename(name: str, app: App) -> None:
    def submit(new: str, app: App) -> None:
        app.ask(ChangeOption(name, new), then=partial(_know, app))

    app.show(
        TextScreen(_('What should it be called?'), name, name, submit, partial(_change, name))
    )


def _delete(name: str, app: App) -> None:
    def delete(app: App) -> None:
        app.ask(ChangeOption(name), then=partial(_know, app))

    question = _(
        'Delete {name}? The learner forgets it; the recording keeps its demonstrations.'
    ).format(name=name)
    app.show(confirm(question, delete, partial(_change, name)))


def _list_taught(app: App) -> None:
    def listed(answer: Answer) -> None:
        if answer.option_names:
            items = _items(answer.option_names, to_run, app)
            app.show(ListScreen(_('Run which option?'), items, to_menu))
        else:
            app.say(_('No option is taught yet: one can be run after its first demonstration.'))

    app.ask(ListOptions(app.participant), then=listed)


def _choose_plan(app: App) -> None:
    items = [
        Item(text, note, partial(_watch, action_set, ''))
        for action_set, text, note in (
            (HUMAN, _('With your options'), _('decides only where an option ends')),
            (PRIMITIVE, _('With single steps'), _('decides at every step')),
            (HUMAN_AND_PRIMITIVE, _('With both'), _('options where they help')),
        )
    ]
    if not can_simulate(app.domain):
        note = _('tries your options out, and learns which to choose')
        items.append(Item(_('Learn while driving'), note, partial(_watch, HUMAN, Q)))
    app.show(ListScreen(_('Plan with what?'), items, to_menu))


def _watch(action_set: str, learning: str, app: App) -> None:
    """Show the screen that plans and plays; ask once for the columns of the plan first."""
    abstract = isinstance(app.domain, ReplayedDomain) or not can_simulate(app.domain)
    asked = abstract and action_set != PRIMITIVE
    if asked and len(app.known_options) > 1 and app.participant not in app.choice_columns:
        _ask_columns(partial(_watch, action_set, learning), app)
        return
    columns = app.choice_columns.get(app.participant, ()) if asked else ()
    screen = WatchScreen(
        to_menu,
        teach=_choose_known,
        correct=correct,
        action_set=action_set,
        columns=columns,
        learning=learning,
    )
    if learning:
        screen.title = _('Let the machine learn in {count} episodes').format(
            count=LEARNING_EPISODES
        )
        screen.text = _('It learns from each option that it runs. An action key takes over.')
    app.show(screen)


def _ask_columns(then: Do, app: App) -> None:
    """Ask what the choice between options depends on; the first answer is the default."""

    def choose(columns: tuple[str, ...], app: App) -> None:
        app.choice_columns[app.participant] = columns
        then(app)

    def choose_feature(feature: Feature, app: App) -> None:
        if feature.kind is not FeatureKind.CONTINUOUS:
            choose((feature.name,), app)
            return
        text = _('Numbers from {low:g} to {high:g}, separated by commas.').format(
            low=feature.low, high=feature.high
        )
        middle = f'{feature.low + feature.span / 2:g}'
        title = _('At which values of {name} does the choice change?').format(name=feature.name)

        def submit(numbers: str, app: App) -> None:
            column = f'{feature.name}:{numbers.replace(" ", "")}'
            try:
                Column(column, app.domain)
            except PlanError as error:
                app.say(translated(str(error)), bad=True)
            else:
                choose((column,), app)

        app.show(TextScreen(title, text, middle, submit, partial(_ask_columns, then)))

    def list_features(app: App) -> None:
        features = [
            Item(feature.name, translated(feature.question), partial(choose_feature, feature))
            for feature in app.domain.features
        ]
        title = _('On which feature does the choice depend?')
        app.show(ListScreen(title, features, partial(_ask_columns, then)))

    items = [
        Item(_('On nothing else'), _('than what the options depend on'), partial(choose, ())),
        Item(
            _('On another feature'), _('such as a battery that no option looks at'), list_features
        ),
    ]
    if column := app.world.lesson.suggested_column:
        name, numbers = (*column.split(':', 1), '')[:2]
        count = numbers.count(',') + 2
        bins = (
            _('in {count} bins').format(count=count)
            if count > 2
            else _('split at {numbers}').format(numbers=numbers)
        )
        text = (
            _('On {name}, {bins}').format(name=name, bins=bins)
            if numbers
            else _('On {name}').format(name=name)
        )
        note = _('it tells the starts of your options apart')
        items.insert(0, Item(text, note, partial(choose, (column,))))
    title = _('What does the choice between your options depend on?')
    app.show(ListScreen(title, items, _choose_plan))


def _play(app: App) -> None:
    screen = PlayScreen(to_menu)
    app.show(screen)
    if not app.world.game.open:
        app.ask(screen.new_start(app))


def _play_whole(app: App) -> None:
    screen = WholeTaskScreen(to_menu, run=to_run)
    app.show(screen)
    app.ask(screen.new_start(app))
