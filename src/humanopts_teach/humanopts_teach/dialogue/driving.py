"""Screens in which the game is played: by the person, by a taught option, by a plan."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, KW_ONLY, replace
from functools import partial
from typing import ClassVar

from humanopts_env.seeding import generator
from humanopts_learner.planning.request import Arbitration, HUMAN, HUMAN_AND_PRIMITIVE
from humanopts_teach.dialogue.app import App, Screen
from humanopts_teach.dialogue.entry import HelpScreen, Item, ListScreen
from humanopts_teach.dialogue.keys import key_table, KeyCommand, Keys, KeyTable, label
from humanopts_teach.lesson.requests import (
    ActionGoal,
    Answer,
    CancelRun,
    NewEpisode,
    PlanOptions,
    PlayEpisodes,
    Request,
    RunOption,
    SetControl,
    SetExecution,
    SetPace,
)

EPISODES = 5  # that are watched
EXECUTIONS = {
    Arbitration.RUN_TO_END: 'each option to its end',
    Arbitration.INTERRUPTED: 'options stop where another is worth more',
    Arbitration.MODULAR_MASS: 'all options act at once: the greatest mass',
    Arbitration.MODULAR_STRONGEST: 'all options act at once: the strongest',
}
# While the machine drives.
PACE = (KeyCommand.PAUSE, KeyCommand.STEP, KeyCommand.SLOWER, KeyCommand.FASTER)
_NOT_THEN = (KeyCommand.NEW_START, KeyCommand.RUN_HERE, KeyCommand.UNCOVERED)
PERIODS = (2.0, 1.0, 0.5, 0.25, 0.1, 0.0)  # s between steps of the machine
_COMMANDS = (KeyCommand.NEW_START, KeyCommand.MENU, KeyCommand.HELP, KeyCommand.QUIT)
_UNKNOWN_COVERAGE = (
    'Uncovered places are known for plans with your options alone, in games whose states can all '
    'be listed.'
)


def set_pace(command: KeyCommand, app: App) -> None:
    """Pause, resume or single-step the machine, or let it move slower or faster."""
    period, paused = app.world.step_period, bool(app.world.paused_by)
    if command in (KeyCommand.PAUSE, KeyCommand.STEP):
        step = command is KeyCommand.STEP
        app.ask(SetPace(period, paused=step or not paused, steps=int(step)))
        return
    near = min(range(len(PERIODS)), key=lambda n: abs(PERIODS[n] - period))
    other = near + (1 if command is KeyCommand.FASTER else -1)
    app.ask(SetPace(PERIODS[max(0, min(other, len(PERIODS) - 1))], paused))


def pace_words(app: App) -> dict[KeyCommand, str]:
    """Return what the keys of the pace do, where that is not what their names say."""
    return {KeyCommand.PAUSE: 'resume'} if app.world.paused_by else {}


@dataclass
class PlayScreen(Screen):
    """The person drives as they like; nothing of it is a demonstration."""

    menu: Callable[[App], None]
    title: str = 'Drive freely'
    text: str = 'Nothing here is a demonstration.'
    commands: ClassVar[Sequence[KeyCommand]] = _COMMANDS
    words: ClassVar[Mapping[KeyCommand, str]] = {}  # what a key does here, where that differs

    def press(self, key: str, app: App) -> None:
        """Drive, which takes control, or carry out a command."""
        table = self.table(app)
        action, command = table.action(key), table.command(key)
        if action is not None:
            app.drive(action)
        elif command is KeyCommand.RUN_HERE and app.run is None:
            self.start(app)
        elif command is KeyCommand.NEW_START and app.run is None:
            app.ask(self.new_start(app))
        elif command in PACE:
            set_pace(command, app)
        elif command is KeyCommand.MENU:
            if app.run is not None:
                app.go_on()
                app.ask(CancelRun())
            else:
                self.menu(app)
        elif command is KeyCommand.HELP:
            keys = self._shown(app).help(app.domain.actions, self._words(app))
            app.show(HelpScreen(keys, self.again))
        elif command is KeyCommand.QUIT:
            app.end()

    def start(self, app: App) -> None:
        """Have the machine begin. To be overridden where a machine plays."""

    def new_start(self, app: App) -> Request:
        """Return the request for an episode from a start state of the task."""
        rng = generator(app.seed, 'terminal episode', app.participant, app.world.game.episode)
        return NewEpisode(int(rng.integers(2**63)))

    def table(self, app: App) -> KeyTable:
        pace = PACE if app.run is not None else ()
        return key_table(app.domain.actions, (*pace, *self.commands))

    def keys(self, app: App) -> Keys:
        actions = [(label(action.key), action.name) for action in app.domain.actions]
        return [*actions, *self._shown(app).labelled(self._words(app))]

    def _shown(self, app: App) -> KeyTable:
        """Return the keys that do something now."""
        table, without = self.table(app), () if app.run is None else _NOT_THEN
        commands = {key: each for key, each in table.commands.items() if each not in without}
        return replace(table, commands=commands)

    def _words(self, app: App) -> Mapping[KeyCommand, str]:
        stop = {KeyCommand.MENU: 'stop it'} if app.run is not None else {}
        return {**self.words, **stop, **pace_words(app)}


@dataclass
class RunScreen(PlayScreen):
    """The machine runs one taught option; a person's action key takes over."""

    commands: ClassVar[Sequence[KeyCommand]] = (KeyCommand.RUN_HERE, *_COMMANDS)
    text: str = 'The machine runs it from the state shown. An action key takes over.'
    _: KW_ONLY
    option_name: str

    def __post_init__(self) -> None:
        self.title = f'Run: {self.option_name}'

    def start(self, app: App) -> None:
        """Give control back, and run the option from the current state."""
        first = [] if app.world.game.open else [self.new_start(app)]
        app.ask(*first, SetControl(hold=False), RunOption(self.option_name, app.participant))


@dataclass
class WatchScreen(PlayScreen):
    """The machine plans and plays episodes; a person's action key takes over."""

    commands: ClassVar[Sequence[KeyCommand]] = (
        KeyCommand.RUN_HERE,
        KeyCommand.EXECUTION,
        KeyCommand.UNCOVERED,
        *_COMMANDS,
    )
    words: ClassVar[Mapping[KeyCommand, str]] = {KeyCommand.RUN_HERE: 'plan and play'}
    title: str = f'Watch the machine play {EPISODES} episodes'
    text: str = 'It plans first, then plays. An action key takes over.'
    _: KW_ONLY
    teach: Callable[[App], None]
    action_set: str
    execution: Arbitration = Arbitration.RUN_TO_END

    def press(self, key: str, app: App) -> None:
        """Change the execution, also of a run under way; do with other keys as elsewhere."""
        command = self.table(app).command(key)
        if command is KeyCommand.UNCOVERED and app.run is None:
            self._show_uncovered(app)
        elif command is KeyCommand.EXECUTION:
            known = list(EXECUTIONS)
            other = known[(known.index(self.in_force(app)) + 1) % len(known)]
            if isinstance(app.run, PlayEpisodes):
                app.ask(SetExecution(other))
            else:
                self.execution = other
        else:
            super().press(key, app)

    def replied(self, request: Request, answer: Answer, app: App) -> None:
        """Keep the new execution for the runs that follow."""
        if isinstance(request, SetExecution) and answer.ok:
            self.execution = Arbitration(request.execution)

    def in_force(self, app: App) -> Arbitration:
        """Return how it plays, or will play."""
        playing = isinstance(app.run, PlayEpisodes) and app.world.execution
        return Arbitration(app.world.execution) if playing else self.execution

    def start(self, app: App) -> None:
        app.ask(SetControl(hold=False), PlanOptions(self.action_set, app.participant, app.seed))

    def run_ended(self, run: ActionGoal, well: bool, app: App) -> None:
        """Play once it is planned, and name the options that are not yet learned well enough."""
        if well and isinstance(run, PlanOptions):
            unready = [
                summary.option_name
                for summary in app.world.summaries
                if summary.participant == app.participant and not summary.criteria_met
            ]
            if unready and self.action_set in (HUMAN, HUMAN_AND_PRIMITIVE):
                names = ', '.join(unready)
                app.say(f'{app.message.text} The criteria of {names} are not met yet.', bad=True)
            app.ask(
                PlayEpisodes(self.action_set, app.participant, EPISODES, app.seed, self.execution)
            )
        elif well and app.world.uncovered:
            number, key = len(app.world.uncovered), self.table(app).key(KeyCommand.UNCOVERED)
            app.say(f'{app.message.text} Uncovered places: {number}; {key} lists them.')

    def _show_uncovered(self, app: App) -> None:
        """List where the options of the plan cannot start, or are worth less than single steps."""
        if not app.world.uncovered:
            known = app.world.uncovered is not None
            app.say('The options cover every place of the plan.' if known else _UNKNOWN_COVERAGE)
            return

        def teach_from(state: str, app: App) -> None:
            app.next_start = state
            self.teach(app)

        items = [
            Item(
                f'A single step is worth {gain:.2g} more' if gain else 'No option can start here',
                '',
                partial(teach_from, state),
                (state,),
            )
            for state, gain in app.world.uncovered
        ]
        app.show(ListScreen('Uncovered: teach from which place?', items, back=self.again))
