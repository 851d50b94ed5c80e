"""The way from screen to screen: who teaches, what to do, which option."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

from humanopts_env.domains.base import is_enumerable
from humanopts_learner.demonstrations import GOAL, METHODS, TREES
from humanopts_teach.dialogue.app import App
from humanopts_teach.dialogue.driving import PlayScreen, RunScreen, WatchScreen
from humanopts_teach.dialogue.entry import ConfirmScreen, Item, ListScreen, TextScreen
from humanopts_teach.dialogue.keys import ESCAPE, Keys
from humanopts_teach.dialogue.teaching import LessonScreen
from humanopts_teach.lesson.requests import (
    Answer,
    ChangeOption,
    DefineOption,
    EndDemonstration,
    ListOptions,
    OpenSession,
    Phase,
    Request,
    SetControl,
    UNKNOWN,
    Verdict,
)


@dataclass
class OpeningScreen(TextScreen):
    """
    The first screen: who teaches.

    :ivar known: the code need not be asked for: it is taken once the lesson is there. The person
        is asked only where it is refused.
    """

    known: bool = False
    claims_lesson: ClassVar[bool] = True

    def tick(self, app: App) -> None:
        """Take the code that is known, once."""
        if self.known and app.world.lesson is not UNKNOWN:
            self.known = False
            self.submit(self.typed, app)


class DisplacedScreen(ConfirmScreen):
    """The lesson is no longer this person's; no key that was meant for it takes it back."""

    claims_lesson: ClassVar[bool] = True

    def __init__(self) -> None:
        super().__init__('The lesson is no longer yours. Take it back?', _come_back, to_menu)

    def press(self, key: str, app: App) -> None:
        if key == 't':
            self.affirm(app)
        elif key == ESCAPE:
            self.back(app)

    def replied(self, request: Request, answer: Answer, app: App) -> None:
        _entered(request, answer, app)

    def keys(self, app: App) -> Keys:
        return [('t', 'take it back'), ('Esc', 'menu'), ('Ctrl-C', 'quit')]


def opening(participant: str, *, ask: bool = True) -> OpeningScreen:
    """
    Return the first screen.

    :param participant: code that is proposed, or taken.
    :param ask: whether the person is asked.
    """
    return OpeningScreen(
        'Who teaches?',
        'Your code keeps your options apart from those of others. Enter accepts it.',
        typed=participant,
        submit=_enter,
        answered=_entered,
        known=not ask,
    )


def _enter(code: str, app: App) -> None:
    lesson = app.world.lesson
    under_way = lesson.phase is Phase.DEMONSTRATING
    app.claim_lesson(code, DisplacedScreen())
    # A terminal that was cut off left a demonstration under way: that of the same person goes on.
    if under_way and lesson.participant == code:
        app.known_options = (lesson.option_name,)
        to_lesson(app)
    elif under_way and not app.world.holder:
        who = lesson.participant
        question = (
            f'{who} has a demonstration under way, but is not in control now. {who} may still '
            'be there. Discard it?'
        )
        app.show(ConfirmScreen(question, partial(_take_over, lesson.episode), app.screen.again))
    else:
        app.ask(OpenSession(code))


def _come_back(app: App) -> None:
    _enter(app.participant, app)


def _take_over(episode: int, app: App) -> None:
    """Discard a demonstration that somebody else left, if it still is as it was; then come in."""
    lesson = app.world.lesson
    under_way = lesson.phase is Phase.DEMONSTRATING and lesson.episode == episode
    if under_way and not app.world.holder:
        app.ask(EndDemonstration(Verdict.DISCARD, episode, 0))
    app.ask(OpenSession(app.participant))


def _entered(request: Request, answer: Answer, app: App) -> None:
    if answer.ok and isinstance(request, OpenSession):
        app.known_options = answer.known_options
        to_menu(app)


def to_menu(app: App) -> None:
    """Give control back, and show what can be done."""
    if app.world.i_drive:
        app.ask(SetControl(hold=False))
    app.next_start = ''
    known = len(app.known_options)
    items = [Item('Teach a new option', 'name it, answer questions, show it', _name_option)]
    if known:
        text = f'{known} begun so far'
        items.append(Item('Go on teaching an option', text, _choose_known))
    items += [
        Item('Run a taught option', 'the machine runs it, you watch', _list_taught),
        Item('Watch the machine play', 'it plans, then plays', _choose_plan),
        Item('Drive freely', 'get to know the game and the keys', _play),
    ]
    if known:
        note = 'rename or delete it, or learn it in another way'
        items.append(Item('Change an option', note, _choose_changed))
    items.append(Item(*app.leaving, lambda app: app.end()))
    app.show(ListScreen('What next?', items, answered=_listed))


def to_lesson(app: App) -> None:
    """Show the lesson as it stands."""
    app.groups.forget()
    app.show(LessonScreen(menu=to_menu, run=to_run))


def to_run(option_name: str, app: App) -> None:
    """Show the screen from which one option is run."""
    app.show(RunScreen(menu=to_menu, option_name=option_name))


def _name_option(app: App) -> None:
    app.show(
        TextScreen(
            'What is the option called?',
            'In your own words: go to ..., avoid ..., fetch ...',
            submit=lambda name, app: app.ask(DefineOption(name)),
            answered=_defined,
            back=to_menu,
        )
    )


def _defined(request: Request, answer: Answer, app: App) -> None:
    if answer.ok and isinstance(request, DefineOption):
        if request.name not in app.known_options:
            app.known_options = (*app.known_options, request.name)
        to_lesson(app)


def _choose_known(app: App) -> None:
    items = [Item(name, _standing(name, app), _defining(name)) for name in app.known_options]
    items.append(Item('A new option', '', _name_option))
    app.show(ListScreen('Go on with which option?', items, back=to_menu, answered=_defined))


def _choose_changed(app: App) -> None:
    items = [
        Item(name, _standing(name, app), partial(_change, name)) for name in app.known_options
    ]
    app.show(ListScreen('Change which option?', items, back=to_menu))


def _change(name: str, app: App) -> None:
    items = [
        Item('Rename it', 'its demonstrations are kept', partial(_rename, name)),
        Item('Delete it', 'its demonstrations no longer count', partial(_delete, name)),
    ]
    if is_enumerable(app.domain):
        progress = app.world.summary_of(app.participant, name)
        other = TREES if progress is not None and progress.method == GOAL else GOAL
        note = f'{METHODS[other]}, from the next demonstration on'
        items.append(Item(f'Learn it by {other}', note, _defining(name, other)))
    app.show(ListScreen(name, items, back=_choose_changed, answered=_changed))


def _rename(name: str, app: App) -> None:
    def submit(new: str, app: App) -> None:
        app.ask(ChangeOption(name, new))

    back = partial(_change, name)
    app.show(TextScreen('What should it be called?', name, name, submit, _changed, back))


def _delete(name: str, app: App) -> None:
    question = f'Delete {name}? The learner forgets it; the recording keeps its demonstrations.'
    back = partial(_change, name)
    app.show(ConfirmScreen(question, lambda app: app.ask(ChangeOption(name)), back))


def _changed(request: Request, answer: Answer, app: App) -> None:
    if answer.ok and isinstance(request, ChangeOption):
        app.known_options = answer.known_options
        to_menu(app)
    else:
        _defined(request, answer, app)


def _defining(name: str, method: str = '') -> Callable[[App], None]:
    return lambda app: app.ask(DefineOption(name, method=method))


def _standing(name: str, app: App) -> str:
    progress = app.world.summary_of(app.participant, name)
    if progress is None:
        return 'nothing learned yet'
    held = ', all criteria met' if progress.criteria_met else ''
    return f'{progress.n_demonstrations} shown, {progress.n_not_here} not here{held}'


def _list_taught(app: App) -> None:
    app.ask(ListOptions(app.participant))


def _listed(request: Request, answer: Answer, app: App) -> None:
    if not answer.ok or not isinstance(request, ListOptions):
        return
    if not answer.option_names:
        app.say('No option is taught yet: one can be run after its first demonstration.')
        return
    items = [
        Item(name, _standing(name, app), partial(to_run, name)) for name in answer.option_names
    ]
    app.show(ListScreen('Run which option?', items, back=to_menu))


def _choose_plan(app: App) -> None:
    sets = {
        'human': ('With your options', 'decides only where an option ends'),
        'primitive': ('With single steps', 'decides at every step'),
        'human+primitive': ('With both', 'options where they help'),
    }
    items = [Item(*words, _watching(action_set)) for action_set, words in sets.items()]
    app.show(ListScreen('Plan with what?', items, back=to_menu))


def _watching(action_set: str) -> Callable[[App], None]:
    return lambda app: app.show(
        WatchScreen(menu=to_menu, teach=_choose_known, action_set=action_set)
    )


def _play(app: App) -> None:
    screen = PlayScreen(menu=to_menu)
    app.show(screen)
    if not app.world.game.open:
        app.ask(screen.new_start(app))
