"""The screen of one option's lesson: questions, demonstrations, criteria."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import ClassVar

from humanopts_env.domains.capabilities import FeatureGroup
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.options.rollout import is_deterministic
from humanopts_teach.dialogue.app import App, Keys, Screen
from humanopts_teach.dialogue.driving import PACE, pace_words, set_pace
from humanopts_teach.dialogue.entry import ConfirmScreen, HelpScreen, Item, ListScreen
from humanopts_teach.dialogue.keys import Command, ENTER, key_table, KeyTable, label, SPACE
from humanopts_teach.lesson.question_groups import GroupAnswer
from humanopts_teach.lesson.requests import (
    Answer,
    AnswerQuestion,
    BeginDemonstration,
    DefineOption,
    EndDemonstration,
    LessonView,
    ListDemonstrations,
    Phase,
    Request,
    RunOption,
    SetControl,
    Verdict,
    WithdrawDemonstration,
)

_ALWAYS = (Command.QUESTIONS, Command.MENU, Command.HELP, Command.QUIT)
_IN_PHASE: dict[Phase, tuple[Command, ...]] = {
    Phase.DEMONSTRATING: (
        Command.DONE,
        Command.START_AGAIN,
        Command.NOT_HERE,
        Command.DISCARD,
        Command.UNDO,
        Command.WATCH,
        Command.DEMONSTRATIONS,
        *_ALWAYS,
    ),
    Phase.ASKING: (Command.BACK, Command.MENU, Command.HELP, Command.QUIT),
    Phase.READY: (
        Command.BEGIN,
        Command.WATCH,
        Command.DEMONSTRATIONS,
        Command.BACK,
        *_ALWAYS,
    ),
    Phase.FINISHED: (
        Command.BEGIN,
        Command.RUN,
        Command.WATCH,
        Command.DEMONSTRATIONS,
        *_ALWAYS,
    ),
}
_ELSE = (Command.MENU, Command.HELP, Command.QUIT)
_LONG = {
    Command.DONE: 'the option ends here: keep this demonstration',
    Command.START_AGAIN: 'with done: the option could start again where it ended, or could not',
    Command.NOT_HERE: 'the option makes no sense from this start; only before the first step',
    Command.DISCARD: 'forget this demonstration and try the same start again',
    Command.UNDO: 'undo your last step, in a new episode that is driven there again',
    Command.DEMONSTRATIONS: 'list what was shown; any of it can be looked at and deleted',
    Command.WATCH: 'watch the option from a start of the task; an action key of yours takes over',
    Command.QUESTIONS: 'answer again what the option depends on, Enter for an answer as before',
    Command.MENU: 'to the menu; a demonstration under way is discarded',
    Command.QUIT: 'leave; everything taught is saved, and is taken up again next time',
}


@dataclass
class LessonScreen(Screen):
    """Teaching one option; what it shows follows the lesson's phase."""

    menu: Callable[[App], None]
    run: Callable[[str, App], None]
    automatic: bool = False  # the next demonstration begins by itself
    rest: bool = False  # all other questions are answered no, or as before
    redo: list[str] = field(default_factory=list)  # actions that are taken again after an undo
    delete: str = ''  # uuid of the demonstration that is taken back once the learner is done
    answers_lesson: ClassVar[bool] = True

    def press(self, key: str, app: App) -> None:
        """Carry out one key as the phase has it."""
        lesson = app.world.lesson
        if self.redo:
            return
        table = self.table(app)
        action, command = table.action(key), table.command(key)
        self.rest = False
        group = _open_group(app)
        if group is not None and (answer := _group_answer(key, lesson)) is not None:
            app.groups.answer(group, answer)
        elif group is None and lesson.phase is Phase.ASKING and key in tuple('yYnN'):
            app.ask(AnswerQuestion(lesson.question_id, key in 'yY'))
        elif lesson.phase is Phase.ASKING and key == ENTER and lesson.earlier_features:
            app.ask(_as_before(lesson))
        elif key in tuple('oO') and _can_skip(lesson):
            self.rest = True
        elif lesson.phase is Phase.READY and key == SPACE:
            self._begin(app)
        elif action is not None:
            app.drive(action)
        elif command is not None:
            self._carry_out(command, lesson, app)

    def tick(self, app: App) -> None:
        """Begin the next demonstration, or answer a question that needs no person."""
        lesson = app.world.lesson
        if self.redo:
            if lesson.phase is Phase.DEMONSTRATING:
                app.drive(self.redo.pop(0))
        elif self.delete:
            if lesson.phase is not Phase.LEARNING:
                self._discard(app)
                app.ask(WithdrawDemonstration(self.delete))
                self.delete = ''
        elif self.rest and _can_skip(lesson):
            app.ask(_as_before(lesson))
        elif lesson.phase is Phase.ASKING:
            reply = app.groups.reply(app.domain, lesson)
            if reply is not None:
                app.ask(AnswerQuestion(lesson.question_id, reply))
        elif self.automatic and lesson.phase is Phase.READY:
            self._begin(app)

    def replied(self, request: Request, answer: Answer, app: App) -> None:
        """Go on to the next start state, or stop where something was refused."""
        lesson = app.world.lesson
        if not answer.carried_out:
            self.redo = []
        if isinstance(request, BeginDemonstration):
            self.automatic, app.next_start = False, ''
            if request.watch and answer.ok:
                app.ask(SetControl(hold=False), RunOption(lesson.option_name, app.participant))
        elif isinstance(request, AnswerQuestion) and not answer.ok:
            self.rest = False
            app.groups.forget()
        elif isinstance(request, AnswerQuestion) and request.back:
            group, said = app.groups.asked(app.domain, lesson)
            if group is not None and said is not GroupAnswer.EACH:
                app.groups.take_back(group)
                if lesson.question_feature != group.features[0]:
                    app.ask(AnswerQuestion(lesson.question_id, back=True))
        elif isinstance(request, EndDemonstration) and answer.ok:
            self.automatic = not lesson.paused
            if answer.contradiction:
                self._show_contradiction(answer, app)
        elif isinstance(request, ListDemonstrations) and answer.ok:
            self._show_demonstrations(answer.demonstrations, app)

    def table(self, app: App) -> KeyTable:
        lesson, phase = app.world.lesson, app.world.lesson.phase
        actions = app.domain.actions if phase is Phase.DEMONSTRATING else ()
        without = set() if lesson.n_demonstrations else {Command.WATCH}
        without |= _impossible(app)
        first = lesson.question_feature == app.domain.features[0].name
        if phase is Phase.ASKING and first and app.groups.asked(app.domain, lesson)[1] is None:
            without.add(Command.BACK)
        commands = [command for command in _IN_PHASE.get(phase, _ELSE) if command not in without]
        return key_table(actions, (*PACE, *commands) if app.run is not None else commands)

    def questions_key(self, app: App) -> str:
        """Return the label of the key that asks the questions again; empty: not now."""
        table = self.table(app)
        known = Command.QUESTIONS in table.commands.values()
        return table.key(Command.QUESTIONS) if known else ''

    def ending_keys(self, app: App) -> tuple[str, str]:
        """Return the labels of the keys about ends: it can start again there; what was shown."""
        table = _showing(app)
        return table.key(Command.START_AGAIN), table.key(Command.DEMONSTRATIONS)

    def keys(self, app: App) -> Keys:
        phase, table = app.world.lesson.phase, self.table(app)
        first = _question_keys(app) if phase is Phase.ASKING else []
        if phase is Phase.DEMONSTRATING:
            first = [(label(action.key), action.name) for action in app.domain.actions]
        again = f'can restart at its end: {"YES" if _can_start_again(app) else "no"}'
        words = {Command.START_AGAIN: again, **pace_words(app)}
        if phase is Phase.FINISHED:
            words |= {Command.BEGIN: 'show one more', Command.MENU: 'menu, next option'}
        return first + table.labelled(words)

    def _carry_out(self, command: Command, lesson: LessonView, app: App) -> None:
        def leave(words: str, go: Callable[[App], None]) -> None:
            self._leave(words, go, app)

        if app.run is not None and command in (Command.DONE, Command.NOT_HERE):
            app.ask(SetControl(hold=True))
            app.say('The machine has stopped. Look where it stands, and press the key again.')
            return
        does: dict[Command, Callable[[], None]] = {
            Command.BEGIN: lambda: self._begin(app),
            Command.DONE: lambda: self._done(app),
            Command.NOT_HERE: lambda: self._verdict(Verdict.NOT_HERE, app),
            Command.DISCARD: lambda: self._discard(app),
            Command.UNDO: lambda: self._undo(lesson, app),
            Command.DEMONSTRATIONS: lambda: app.ask(ListDemonstrations()),
            Command.WATCH: lambda: self._watch(_random_start(app), app),
            Command.BACK: lambda: self._back(lesson, app),
            **{pace: partial(set_pace, pace, app) for pace in PACE},
            Command.START_AGAIN: lambda: app.can_start_again.update(
                {lesson.option_name: not _can_start_again(app)}
            ),
            Command.QUESTIONS: lambda: leave('Answer the questions again', self._ask_again),
            Command.RUN: lambda: self.run(lesson.option_name, app),
            Command.MENU: lambda: leave('Go to the menu', self.menu),
            Command.HELP: lambda: app.show(HelpScreen(_help(app), self.again)),
            Command.QUIT: lambda: leave('Quit', lambda app: app.end()),
        }
        does[command]()

    def _back(self, lesson: LessonView, app: App) -> None:
        group, said = app.groups.asked(app.domain, lesson)
        if group is not None and said is not None and lesson.question_feature == group.features[0]:
            app.groups.take_back(group)
        else:
            app.ask(AnswerQuestion(lesson.question_id, back=True))

    def _begin(self, app: App) -> None:
        app.ask(BeginDemonstration(app.next_start))

    def _done(self, app: App) -> None:
        """Say done; ask once more where the last step had no effect."""
        effect = app.world.last_effect
        if effect is None or effect.changed:
            self._count(app)
            return
        question = f'The last step had no effect ({effect.text}). Does the option end here?'
        app.show(ConfirmScreen(question, self._count, self.again))

    def _count(self, app: App) -> None:
        """Keep the demonstration; ask whether the steps count that the machine took before."""
        steps = app.world.lesson.machine_steps
        if not steps:
            self._verdict(Verdict.DONE, app)
            return

        def keep(app: App, *, counts: bool) -> None:
            app.show(self)
            self._verdict(Verdict.DONE, app, counts=counts)

        items = [Item('Yes', 'all of it is right', partial(keep, counts=True))]
        if app.world.game.step > steps:
            items.append(Item('No', 'it begins where I took over', partial(keep, counts=False)))
        title = f'The machine took the first {steps}. Do its steps count as shown by you?'
        app.show(ListScreen(title, items, back=self.again))

    def _verdict(self, verdict: Verdict, app: App, *, counts: bool = False) -> None:
        game, again = app.world.game, _can_start_again(app) and verdict is Verdict.DONE
        app.ask(EndDemonstration(verdict, game.episode, game.step, again, counts))

    def _discard(self, app: App) -> None:
        """Discard the demonstration under way, if there is one."""
        if app.run is not None:
            app.ask(SetControl(hold=True))
        if app.world.lesson.phase is Phase.DEMONSTRATING:
            self._verdict(Verdict.DISCARD, app)

    def _undo(self, lesson: LessonView, app: App) -> None:
        """Drive again, in a new episode, all that the person has driven but the last step."""
        since, driven = app.world.since, app.world.driven
        if since is None or since.step != lesson.machine_steps or not driven:
            app.say('There is no step of yours to undo.', bad=True)
        elif lesson.paused:
            app.say('Not now: the lesson is paused, and could not begin again.', bad=True)
        else:
            self.redo = driven[:-1]
            self._discard(app)
            app.ask(BeginDemonstration(since.state))

    def _watch(self, start: str, app: App) -> None:
        """Have the machine run the option in a demonstration that the person can take over."""
        app.show(self)
        begin = BeginDemonstration(start, watch=True)
        self._leave('Watch the option', lambda app: app.ask(begin), app)

    def _show_demonstrations(self, shown: Sequence[Demonstration], app: App) -> None:
        if not shown:
            app.say('Nothing was shown yet.')
            return
        back = partial(self._show_demonstrations, shown)
        items = [
            Item(*_in_words(demo), partial(self._show_one, demo, back), demo.states)
            for demo in reversed(shown)
        ]
        app.show(ListScreen('What was shown, the newest first', items, back=self.again))

    def _show_one(self, demo: Demonstration, back: Callable[[App], None], app: App) -> None:
        watch, states = partial(self._watch, demo.states[0]), demo.states
        items = [Item('Watch the option from its start', 'and correct it', watch, states)]
        if not demo.withdrawn:
            note = 'it counts no more, and its start comes again'
            items.append(Item('Delete it', note, partial(self._delete, demo.uuid), states))
        title = ' '.join(_in_words(demo))
        app.show(ListScreen(title, items, back))

    def _show_contradiction(self, answer: Answer, app: App) -> None:
        """Have the person choose between what was kept and what contradicts it."""
        items = [
            Item(text, note, partial(self._delete, deleted), (answer.situation,))
            for text, note, deleted in (
                ('Keep both', '', ''),
                ('Keep the new one', 'the earlier one is deleted', answer.contradicts),
                ('Keep the earlier one', 'the new one is deleted', answer.uuid),
            )
        ]
        app.show(ListScreen(f'Shown differently before. {answer.contradiction}.', items))

    def _delete(self, uuid: str, app: App) -> None:
        """Go on, and take back a demonstration as soon as it can be; empty: none."""
        self.delete = uuid
        app.show(self)

    def _leave(self, words: str, go: Callable[[App], None], app: App) -> None:
        """Discard the demonstration under way and go; ask first if steps were taken."""
        if app.world.lesson.phase is not Phase.DEMONSTRATING:
            go(app)
            return

        def discard(app: App) -> None:
            self._discard(app)
            go(app)

        if app.world.game.step:
            question = f'{words}? The demonstration under way is discarded; all else is saved.'
            app.show(ConfirmScreen(question, discard, self.again))
        else:
            discard(app)

    def _ask_again(self, app: App) -> None:
        app.groups.forget()
        app.ask(DefineOption(app.world.lesson.option_name, ask_again=True))


def _in_words(demo: Demonstration) -> tuple[str, str]:
    """Return a demonstration in a few words, and what else there is to say."""
    steps = len(demo.actions)
    what = f'{steps} step{"s"[: steps != 1]}, return {demo.total_reward:g}'
    notes = [f'by {demo.method}', f'{demo.seconds:.0f} s']
    if demo.machine_steps:
        notes.append(f'{demo.machine_steps} by the machine')
    if demo.withdrawn:
        notes.append('DELETED')
    return f'no. {demo.number}: {what if steps else "not here"}', ', '.join(notes)


def _can_skip(lesson: LessonView) -> bool:
    known = lesson.chosen_features or lesson.earlier_features
    return lesson.phase is Phase.ASKING and bool(known)


def _as_before(lesson: LessonView) -> AnswerQuestion:
    """Answer the open question as it was answered before; no, where it was not."""
    return AnswerQuestion(lesson.question_id, lesson.question_feature in lesson.earlier_features)


def _open_group(app: App) -> FeatureGroup | None:
    """Return the group that is asked about; None: no question is open, or it is of one feature."""
    asking = app.world.lesson.phase is Phase.ASKING
    return app.groups.open_group(app.domain, app.world.lesson) if asking else None


def _group_answer(key: str, lesson: LessonView) -> GroupAnswer | None:
    """Return the answer about a group that a key stands for; None: it stands for none."""
    if key == ENTER and lesson.earlier_features:
        return GroupAnswer.AS_BEFORE
    return {'y': GroupAnswer.EACH, 'n': GroupAnswer.NONE}.get(key.lower())


def _can_start_again(app: App) -> bool:
    """Return whether the next done says that the option could start again there."""
    return app.can_start_again.get(app.world.lesson.option_name, False)


def _random_start(app: App) -> str:
    """Draw a start of the task, another one in each episode."""
    rng = generator(app.seed, 'watched start', app.participant, app.world.game.episode)
    return app.domain.encode(app.domain.reset(rng))


def _question_keys(app: App) -> list[tuple[str, str]]:
    lesson, group = app.world.lesson, _open_group(app)
    keys = [('y', 'yes'), ('n', 'no' if group is None else 'no, to all of them')]
    if lesson.earlier_features:
        asked = {lesson.question_feature} if group is None else set(group.features)
        before = 'yes' if asked & set(lesson.earlier_features) else 'no'
        keys += [(label(ENTER), f'as before: {before}'), ('o', 'all others as before')]
    elif _can_skip(lesson):
        keys.append(('o', 'no to all others'))
    return keys


def _impossible(app: App) -> set[Command]:
    """Return what cannot be done in this game: what chance decides may end otherwise next time."""
    return set() if is_deterministic(app.domain) else {Command.UNDO}


def _showing(app: App) -> KeyTable:
    commands = [c for c in _IN_PHASE[Phase.DEMONSTRATING] if c not in _impossible(app)]
    return key_table(app.domain.actions, commands)


def _help(app: App) -> Sequence[tuple[str, str]]:
    leave = (label('ctrl-c'), 'leave at once')
    if app.world.lesson.phase is Phase.ASKING:
        table = key_table((), _IN_PHASE[Phase.ASKING])
        return [*_question_keys(app), *table.labelled(_LONG), leave]
    table = _showing(app)
    actions = [(label(action.key), action.description) for action in app.domain.actions]
    commands = [(label(key), _LONG[c]) for key, c in table.commands.items() if c in _LONG]
    return [*actions, *commands, leave]
