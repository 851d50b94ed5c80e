"""Screens in which the game is played: by the person, by a taught option, by a plan."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, KW_ONLY, replace
from functools import partial
from typing import ClassVar

from humanopts_env.seeding import generator
from humanopts_learner.planning.request import Arbitration, HUMAN, HUMAN_AND_PRIMITIVE
from humanopts_teach.dialogue.app import App, Keys, Screen
from humanopts_teach.dialogue.entry import HelpScreen, Item, ListScreen
from humanopts_teach.dialogue.keys import Command, key_table, KeyTable, label
from humanopts_teach.lesson.requests import (
    Answer,
    CancelRun,
    NewEpisode,
    PlanOptions,
    PlayEpisodes,
    Request,
    Run,
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
PACE = (Command.PAUSE, Command.STEP, Command.SLOWER, Command.FASTER)  # while the machine drives
PERIODS = (2.0, 1.0, 0.5, 0.25, 0.1, 0.0)  # s between steps of the machine
_COMMANDS = (Command.NEW_START, Command.MENU, Command.HELP, Command.QUIT)
_IDLE = (Command.NEW_START, Command.RUN_HERE, Command.UNCOVERED)  # while the machine drives
_LONG = {
    Command.EXECUTION: 'another way to choose between options: ' + '; '.join(EXECUTIONS.values()),
    Command.UNCOVERED: 'list where no option could start, so that a single step was taken (a '
    'fallback), or a single step was worth more',
    Command.NEW_START: 'begin an episode from a start of the task',
}
_NOT_KNOWN = (
    'What no option covers is known of plans with your options alone, in games whose states can '
    'all be listed.'
)


def set_pace(command: Command, app: App) -> None:
    """Have the machine wait or go on, take a single step, or move slower or faster."""
    period, waits = app.world.step_period, bool(app.world.paused_by)
    if command in (Command.PAUSE, Command.STEP):
        step = command is Command.STEP
        app.ask(SetPace(period, paused=step or not waits, steps=int(step)))
        return
    near = min(range(len(PERIODS)), key=lambda n: abs(PERIODS[n] - period))
    other = near + (1 if command is Command.FASTER else -1)
    app.ask(SetPace(PERIODS[max(0, min(other, len(PERIODS) - 1))], waits))


def pace_words(app: App) -> dict[Command, str]:
    """Return what the keys of the pace do, where that is not what their names say."""
    return {Command.PAUSE: 'go on'} if app.world.paused_by else {}


@dataclass
class PlayScreen(Screen):
    """The person drives as they like; nothing of it is a demonstration."""

    menu: Callable[[App], None]
    title: str = 'Drive freely'
    text: str = 'Nothing here is a demonstration.'
    commands: ClassVar[Sequence[Command]] = _COMMANDS
    words: ClassVar[Mapping[Command, str]] = {}  # what a key does here, where that differs

    def press(self, key: str, app: App) -> None:
        """Drive, which takes control, or carry out a command."""
        table = self.table(app)
        action, command = table.action(key), table.command(key)
        if action is not None:
            app.drive(action)
        elif command is Command.RUN_HERE and app.run is None:
            self.start(app)
        elif command is Command.NEW_START and app.run is None:
            app.ask(self.new_start(app))
        elif command in PACE:
            set_pace(command, app)
        elif command is Command.MENU:
            self._out(app)
        elif command is Command.HELP:
            app.show(HelpScreen(self._help(app), self.again))
        elif command is Command.QUIT:
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
        return [*actions, *self._labelled(app, {})]

    def _out(self, app: App) -> None:
        if app.run is not None:
            app.go_on()
            app.ask(CancelRun())
        else:
            app.ask(SetControl(hold=False))
            self.menu(app)

    def _help(self, app: App) -> Keys:
        actions = [(label(action.key), action.description) for action in app.domain.actions]
        return [*actions, *self._labelled(app, _LONG), ('Ctrl-C', 'leave at once')]

    def _labelled(self, app: App, words: Mapping[Command, str]) -> Keys:
        """Return the keys of the commands and what they do; ``words`` say it in other words."""
        running = app.run is not None
        here = {Command.MENU: 'stop it'} if running else {}
        table, idle = self.table(app), _IDLE if running else ()
        commands = {key: command for key, command in table.commands.items() if command not in idle}
        shown = replace(table, commands=commands)
        return shown.labelled({**here, **self.words, **pace_words(app), **words})


@dataclass
class RunScreen(PlayScreen):
    """The machine runs one taught option; a person's action key takes over."""

    commands: ClassVar[Sequence[Command]] = (Command.RUN_HERE, *_COMMANDS)
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

    commands: ClassVar[Sequence[Command]] = (
        Command.RUN_HERE,
        Command.EXECUTION,
        Command.UNCOVERED,
        *_COMMANDS,
    )
    words: ClassVar[Mapping[Command, str]] = {Command.RUN_HERE: 'plan and play'}
    title: str = f'Watch the machine play {EPISODES} episodes'
    text: str = 'It plans first, then plays. An action key takes over.'
    _: KW_ONLY
    teach: Callable[[App], None]
    action_set: str
    execution: Arbitration = Arbitration.RUN_TO_END

    def press(self, key: str, app: App) -> None:
        """Change the execution, also of a run under way; do with other keys as elsewhere."""
        command = self.table(app).command(key)
        if command is Command.UNCOVERED and app.run is None:
            self._show_uncovered(app)
        if command is not Command.EXECUTION:
            super().press(key, app)
            return
        known = list(EXECUTIONS)
        other = known[(known.index(self.in_force(app)) + 1) % len(known)]
        if isinstance(app.run, PlayEpisodes):
            app.ask(SetExecution(other))
        else:
            self.execution = other

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

    def run_ended(self, run: Run, well: bool, app: App) -> None:
        """Play once it is planned, and name the options that are not yet learned well enough."""
        if well and isinstance(run, PlanOptions):
            if unready := self._unready(app):
                names = ', '.join(unready)
                app.say(f'{app.message.text} The criteria of {names} are not met yet.', bad=True)
            app.ask(
                PlayEpisodes(self.action_set, app.participant, EPISODES, app.seed, self.execution)
            )
        elif well and app.world.uncovered:
            number, key = len(app.world.uncovered), self.table(app).key(Command.UNCOVERED)
            app.say(f'{app.message.text} {number} places are not covered: {key} lists them.')

    def _show_uncovered(self, app: App) -> None:
        """List where the options of the plan cannot start, or are worth less than single steps."""
        if not app.world.uncovered:
            known = app.world.uncovered is not None
            app.say('The options cover all that the plan comes to.' if known else _NOT_KNOWN)
            return

        items = [
            Item(
                f'A single step is worth {gain:.2g} more' if gain else 'No option can start here',
                '',
                partial(self._teach_from, state),
                (state,),
            )
            for state, gain in app.world.uncovered
        ]
        app.show(ListScreen('Not covered: teach from which place?', items, back=self.again))

    def _teach_from(self, state: str, app: App) -> None:
        app.next_start = state
        self.teach(app)

    def _unready(self, app: App) -> list[str]:
        """Return the options of the plan whose criteria do not hold."""
        if self.action_set not in (HUMAN, HUMAN_AND_PRIMITIVE):
            return []
        return [
            option.option_name
            for option in app.world.summaries
            if option.participant == app.participant and not option.criteria_met
        ]
