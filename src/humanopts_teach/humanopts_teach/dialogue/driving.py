"""Screens for playing the game: by the person, a taught option or a plan."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, KW_ONLY, replace
from functools import partial

from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import PRIMITIVE_PREFIX
from humanopts_learner.planning.request import Arbitration, HUMAN, HUMAN_AND_PRIMITIVE, MODULAR
from humanopts_teach.dialogue.app import App, Screen
from humanopts_teach.dialogue.entry import Item, ListScreen, quitting, with_help
from humanopts_teach.dialogue.keys import Command, Do, ENTER, ESCAPE, key_table, SPACE
from humanopts_teach.dialogue.panel import GAP, Line, Panel, Tone
from humanopts_teach.language import _, N_, Number, translated
from humanopts_teach.lesson.requests import (
    ActionGoal,
    Answer,
    CancelRun,
    NewEpisode,
    Phase,
    PlanOptions,
    PlayEpisodes,
    Request,
    RunOption,
    SetControl,
    SetExecution,
    SetPace,
    World,
)

EPISODES = 5  # number of episodes to watch
LEARNING_EPISODES = 20  # number of episodes of learning while driving
EXECUTIONS = {
    Arbitration.RUN_TO_END: N_('each option runs to its end'),
    Arbitration.INTERRUPTED: N_('an option stops where another is worth more'),
    Arbitration.MODULAR_MASS: N_('all options act at once; the greatest mass wins'),
    Arbitration.MODULAR_STRONGEST: N_('all options act at once; the strongest wins'),
}
TAKE = N_('take control')
PERIODS = (2.0, 1.0, 0.5, 0.25, 0.1, 0.0)  # s between steps of the machine
_UNKNOWN_COVERAGE = N_(
    'Uncovered places are known only for plans with your options alone, in games whose states '
    'can all be listed.'
)


def pace(app: App) -> list[Command]:
    """
    Return the commands that pause, resume, single-step, slow down and speed up the machine.

    There are none for a robot, which has its own speed and is stopped instead.
    """
    if app.run is None or app.world.robot:
        return []
    now, paused = app.world.step_period, bool(app.world.paused_by)
    near = min(range(len(PERIODS)), key=lambda n: abs(PERIODS[n] - now))
    slower, faster = PERIODS[max(near - 1, 0)], PERIODS[min(near + 1, len(PERIODS) - 1)]

    def set_to(period: float, paused: bool, steps: int = 0) -> Do:
        return lambda app: app.ask(SetPace(period, paused, steps))

    return [
        Command([SPACE], _('resume') if paused else _('pause'), set_to(now, not paused)),
        Command('.,', _('single step'), set_to(now, True, 1)),
        Command('-', _('slower'), set_to(slower, paused)),
        Command('+', _('faster'), set_to(faster, paused)),
    ]


def pace_line(world: World) -> Line:
    """Return a line that describes the machine's speed."""
    if world.robot:
        shows = world.lesson.phase is Phase.DEMONSTRATING
        where = _(', and your demonstration begins there') if shows else ''
        return Line(_('An action key takes over{where}.').format(where=where), Tone.QUIET)
    if world.paused_by:
        return Line(_('The machine is paused.'), Tone.WARNING)
    limit = _('At most one step every {seconds:g} s.').format(seconds=Number(world.step_period))
    return Line(limit if world.step_period else _('At full speed.'), Tone.QUIET)


def last_step(world: World) -> Iterator[Line]:
    """Yield the effect and reward of the last step, if any."""
    game, effect = world.game, world.last_effect
    if game.step:
        text = (
            translated(effect.text)
            if effect is not None
            else _('last: {action}').format(action=translated(game.previous_action))
        )
        without = effect is not None and not effect.changed
        cut = _(', cut short') if game.cut_short else ''
        tone = Tone.WARNING if without or cut else Tone.PLAIN
        yield Line(
            _('{text} (reward {reward:g}{cut})').format(
                text=text, reward=Number(game.reward), cut=cut
            ),
            tone,
        )


def control(app: App) -> list[Command]:
    """Return the command that takes control of a robot, or lets the machine move it."""
    world = app.world
    if not world.robot:
        return []
    if not world.in_control:
        return [Command('t', _(TAKE), lambda app: app.ask(SetControl(hold=True)))]

    def released(app: App, answer: Answer) -> None:
        app.say(_('The machine may move now. If you leave, the robot stops.'))

    def give_back(app: App) -> None:
        app.ask(SetControl(hold=False), then=partial(released, app))

    text = _('let the machine move the robot while you supervise it')
    return [Command('t', _('give control back'), give_back, text)]


def robot_lines(app: App) -> Iterator[Line]:
    """Yield lines on the robot's current action, or on why it does not move."""
    world, now = app.world, app.world.progress
    if not world.robot:
        return
    if now.stopped:
        yield Line(_('Stopped: {reason}.').format(reason=translated(now.stopped)), Tone.BAD)
    if world.locked:
        table = key_table(app.screen.commands(app)).items()
        key = next(
            (_(': press {key}').format(key=key) for key, each in table if each.words == _(TAKE)),
            '',
        )
        locked = translated(world.locked)
        why = (Line(f'  {locked[:1].upper()}{locked[1:]}.', Tone.QUIET),)
        yield Line(
            _('Nothing moves until you take control{key}.').format(key=key),
            Tone.WARNING,
            more=why,
        )
    if now.action:
        feedback = f'; {now.feedback}' if now.feedback else ''
        text = _('{action}: {seconds:.1f} of {most:g} s{feedback}').format(
            action=translated(now.action),
            seconds=Number(now.seconds),
            most=Number(world.longest(now.action)),
            feedback=feedback,
        )
        yield Line(text, Tone.NEWS, more=(Line('  ' + _('Space stops the robot.'), Tone.QUIET),))
    elif world.supervisor == world.me and not world.in_control:
        yield Line(_('The machine may move. If you leave, the robot stops.'), Tone.QUIET)
    elif not (world.locked or now.stopped):
        yield Line(_('The robot is standing still.'), Tone.QUIET)


@dataclass
class PlayScreen(Screen):
    """The person drives freely; nothing is recorded as a demonstration."""

    menu: Do
    title: str = N_('Drive freely')
    text: str = N_('Nothing you do here counts as a demonstration.')
    leave: str = N_('menu')  # label of the Escape key

    def plays(self, app: App) -> bool:
        return True

    def commands(self, app: App) -> list[Command]:
        idle, stop = app.run is None, Command([ESCAPE], _('stop'), _stop)
        restarts = idle and not app.world.robot
        commands = [
            *(*app.actions(), *pace(app), *self.machine(app), *control(app)),
            Command(
                'no',
                _('new start'),
                (lambda app: app.ask(self.new_start(app))) if restarts else None,
                _('begin an episode from a start of the task'),
            ),
            Command([ESCAPE], _(self.leave), self.menu) if idle else stop,
            *quitting(app),
        ]
        return with_help(commands, self.again)

    def panel(self, app: App) -> Panel:
        world, game = app.world, app.world.game
        lines = [
            Line(_(self.title), strong=True),
            Line(_(self.text), Tone.QUIET),
            *self.mode(app),
            GAP,
        ]
        if app.run is not None:
            lines += [
                Line(
                    _('The machine is driving. {progress}').format(
                        progress=translated(app.run_text)
                    ),
                    Tone.NEWS,
                ),
                pace_line(world),
            ]
            lines += self.running(app)
        if game.episode:
            lines += [
                Line(
                    _('episode {episode}, step {step}').format(
                        episode=game.episode, step=game.step
                    )
                ),
                *last_step(world),
            ]
        if game.terminated:
            lines.append(Line(_('The task is over.'), Tone.NEWS))
        elif game.truncated:
            lines.append(Line(_('The episode is over: step limit reached.'), Tone.WARNING))
        return Panel(lines)

    def machine(self, app: App) -> list[Command]:
        """Return the commands that control the machine."""
        return []

    def mode(self, app: App) -> Iterator[Line]:
        """Yield lines that describe how the machine plays."""
        yield from ()

    def running(self, app: App) -> Iterator[Line]:
        """Yield lines that describe what the machine is running."""
        yield from ()

    def new_start(self, app: App) -> Request:
        """Return the request for a new episode from a start state of the task."""
        rng = generator(app.seed, 'terminal episode', app.participant, app.world.game.episode)
        return NewEpisode(int(rng.integers(2**63)))


def _stop(app: App) -> None:
    app.resume_machine()
    app.ask(CancelRun())


Correct = Callable[[str, App], None]


def _correction(option_name: str, correct: Correct, app: App) -> Command:
    """Return the command that takes over a running option to demonstrate a correction."""
    text = _('stop the option, and show from here what it should do')
    here = option_name and (app.world.game.open or app.world.robot)
    return Command('wc', _('correct it'), partial(correct, option_name) if here else None, text)


@dataclass
class RunScreen(PlayScreen):
    """The machine runs one taught option; a person's action key takes over."""

    text: str = N_('The option runs from the state shown. An action key takes over.')
    _: KW_ONLY
    option_name: str
    correct: Correct

    def __post_init__(self) -> None:
        self.title = _('Run: {option}').format(option=self.option_name)

    def machine(self, app: App) -> list[Command]:
        run = Command([ENTER], _('run it from here'), self._run if app.run is None else None)
        return [run, _correction(self.option_name, self.correct, app)]

    def mode(self, app: App) -> Iterator[Line]:
        summary = app.world.summary_of(app.participant, self.option_name)
        if summary is not None:
            yield Line(translated(summary.status), Tone.GOOD if summary.learned else Tone.WARNING)

    def _run(self, app: App) -> None:
        """Release control and run the option from the current state."""
        first = [] if app.world.game.open else [self.new_start(app)]
        app.ask(*first, *app.release(), RunOption(self.option_name, app.participant))


@dataclass
class WatchScreen(PlayScreen):
    """The machine plans and plays episodes; a person's action key takes over."""

    title: str = N_(f'Watch the machine play {EPISODES} episodes')
    text: str = N_('Enter: the machine plans first, then plays. An action key takes over.')
    _: KW_ONLY
    teach: Do
    correct: Correct
    action_set: str
    columns: tuple[str, ...] = ()  # features that the choice between options depends on
    learning: str = ''  # learning method while driving; empty: plan first
    execution: Arbitration = Arbitration.RUN_TO_END

    def machine(self, app: App) -> list[Command]:
        idle, running = app.run is None, app.world.running
        taught = running if not idle and running in app.known_options else ''
        return [
            Command(
                [ENTER],
                _('learn') if self.learning else _('plan and play'),
                (self._play if self.learning else self._plan) if idle else None,
            ),
            _correction(taught, self.correct, app),
            Command(
                'xm', _('change execution'), self._change, _('choose between options differently')
            ),
            Command(
                'cy',
                _('uncovered places'),
                self._show_uncovered if idle else None,
                _(
                    'list where no option could start (a fallback to a single step), or where a '
                    'single step was worth more'
                ),
            ),
        ]

    def mode(self, app: App) -> Iterator[Line]:
        yield Line(_('Execution: {how}.').format(how=_(EXECUTIONS[self.current_execution(app)])))

    def running(self, app: App) -> Iterator[Line]:
        world, game = app.world, app.world.game
        if self.current_execution(app) not in MODULAR:
            if world.running:
                option = world.running
                if option.startswith(PRIMITIVE_PREFIX):
                    action = translated(option.removeprefix(PRIMITIVE_PREFIX))
                    option = _('one step {action}').format(action=action)
                yield Line(_('Running: {option}').format(option=option))
        # The option that took the last step, if known.
        elif won := world.acted.get((game.action_publisher_id, game.action_sequence)):
            yield Line(_('{option} won this step.').format(option=won))

    def current_execution(self, app: App) -> Arbitration:
        """Return the arbitration of the active run, or of the next one."""
        playing = isinstance(app.run, PlayEpisodes) and app.world.execution
        return Arbitration(app.world.execution) if playing else self.execution

    def run_ended(self, run: ActionGoal, well: bool, app: App) -> None:
        """Start playing after planning, and name the options that are not learned."""
        said = app.message.text
        if well and isinstance(run, PlanOptions):
            unready = [
                summary.option_name
                for summary in app.world.summaries
                if summary.participant == app.participant and not summary.learned
            ]
            if unready and self.action_set in (HUMAN, HUMAN_AND_PRIMITIVE):
                app.say(
                    ' '.join(
                        [said, _('Not learned yet: {names}.').format(names=', '.join(unready))]
                    ),
                    bad=True,
                )
            self._play(app)
        elif well and app.world.uncovered:
            table = key_table(self.commands(app)).items()
            key = next(key for key, each in table if each.do == self._show_uncovered)
            app.say(
                f'{said} '
                + _('Uncovered places: {count}; {key} lists them.').format(
                    count=len(app.world.uncovered), key=key
                )
            )
        elif well and (stuck := app.world.lesson.stuck_options):
            text = _(
                'The plan alone got stuck in {count} of {most} games: continue teaching '
                '{option!r}.'
            )
            count, most = sum(app.world.lesson.stuck_games), app.world.lesson.trial_games
            app.say(f'{said} {text.format(count=count, most=most, option=stuck[0])}')

    def _plan(self, app: App) -> None:
        plan = PlanOptions(self.action_set, app.participant, app.seed, columns=self.columns)
        app.ask(*app.release(), plan)

    def _play(self, app: App) -> None:
        run = PlayEpisodes(self.action_set, app.participant, EPISODES, app.seed, self.execution)
        first: list[Request] = []
        if self.learning:  # no plan is needed
            first, more = app.release(), LEARNING_EPISODES
            run = replace(run, episodes=more, learning=self.learning, columns=self.columns)
        app.ask(*first, run)

    def _change(self, app: App) -> None:
        """Switch to the next arbitration, also for an active run."""
        known = list(EXECUTIONS)
        self.execution = known[(known.index(self.current_execution(app)) + 1) % len(known)]
        if isinstance(app.run, PlayEpisodes):
            app.ask(SetExecution(self.execution))

    def _show_uncovered(self, app: App) -> None:
        """List states where no option can start or a single step is worth more."""
        if not app.world.uncovered:
            known = app.world.uncovered is not None
            app.say(
                _('The options cover every place of the plan.') if known else _(_UNKNOWN_COVERAGE)
            )
            return

        def teach_from(state: str, app: App) -> None:
            app.next_start = state
            self.teach(app)

        items = [
            Item(
                _('A single step is worth {gain:.2g} more').format(gain=Number(gain))
                if gain
                else _('No option can start here'),
                '',
                partial(teach_from, state),
                (state,),
            )
            for state, gain in app.world.uncovered
        ]
        app.show(ListScreen(_('Teach from which uncovered place?'), items, back=self.again))
