"""The screen of one option's lesson: questions, demonstrations, criteria."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import ClassVar

from humanopts_env.domains.capabilities import FeatureGroup
from humanopts_env.domains.described import can_simulate
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.options.rollout import is_deterministic
from humanopts_teach.dialogue.app import App, Screen
from humanopts_teach.dialogue.driving import PACE, pace_words, set_pace
from humanopts_teach.dialogue.entry import ConfirmScreen, HelpScreen, Item, ListScreen
from humanopts_teach.dialogue.keys import (
    ENTER,
    key_table,
    KeyCommand,
    Keys,
    KeyTable,
    label,
    SPACE,
)
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

_LEAVE = (KeyCommand.MENU, KeyCommand.HELP, KeyCommand.QUIT)
_LEARNED = (KeyCommand.WATCH, KeyCommand.DEMONSTRATIONS)
_IN_PHASE: dict[Phase, tuple[KeyCommand, ...]] = {
    Phase.DEMONSTRATING: (
        KeyCommand.DONE,
        KeyCommand.START_AGAIN,
        KeyCommand.NOT_HERE,
        KeyCommand.DISCARD,
        KeyCommand.UNDO,
        *_LEARNED,
        KeyCommand.QUESTIONS,
        *_LEAVE,
    ),
    Phase.ASKING: (KeyCommand.BACK, *_LEAVE),
    Phase.READY: (
        KeyCommand.BEGIN,
        *_LEARNED,
        KeyCommand.BACK,
        KeyCommand.QUESTIONS,
        *_LEAVE,
    ),
    Phase.FINISHED: (
        KeyCommand.BEGIN,
        KeyCommand.RUN,
        *_LEARNED,
        KeyCommand.QUESTIONS,
        *_LEAVE,
    ),
}


@dataclass
class LessonScreen(Screen):
    """Teaching one option; what it shows follows the lesson's phase."""

    menu: Callable[[App], None]
    run: Callable[[str, App], None]
    automatic: bool = False  # the next demonstration begins by itself
    rest: bool = False  # all other questions are answered no, or as before
    redo: list[str] = field(default_factory=list)  # actions that are taken again after an undo
    delete: str = ''  # uuid of the demonstration to withdraw once the learner is done
    answers_lesson: ClassVar[bool] = True

    def press(self, key: str, app: App) -> None:
        """Carry out one key as the phase has it."""
        lesson = app.world.lesson
        if self.redo:
            return
        table, group = self.table(app), _open_group(app)
        action, command = table.action(key), table.command(key)
        asking, before = lesson.phase is Phase.ASKING, bool(lesson.earlier_features)
        self.rest = False
        if group is not None and key in tuple('yYnN'):
            app.groups.answer(group, GroupAnswer.EACH if key in 'yY' else GroupAnswer.NONE)
        elif group is not None and key == ENTER and before:
            app.groups.answer(group, GroupAnswer.AS_BEFORE)
        elif group is None and asking and key in tuple('yYnN'):
            app.ask(AnswerQuestion(lesson.question_id, key in 'yY'))
        elif asking and key == ENTER and before:
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
            if (reply := app.groups.reply(app.domain, lesson)) is not None:
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
                items = [
                    Item(text, note, partial(self._delete, deleted), (answer.situation,))
                    for text, note, deleted in (
                        ('Keep both', '', ''),
                        ('Keep the new one', 'the earlier one is deleted', answer.contradicts),
                        ('Keep the earlier one', 'the new one is deleted', answer.uuid),
                    )
                ]
                title = f'You showed something else before. {answer.contradiction}.'
                app.show(ListScreen(title, items))
        elif isinstance(request, ListDemonstrations) and answer.ok:
            self._show_demonstrations(answer.demonstrations, app)

    def table(self, app: App) -> KeyTable:
        lesson, phase = app.world.lesson, app.world.lesson.phase
        actions = app.domain.actions if phase is Phase.DEMONSTRATING else ()
        without = set() if lesson.n_demonstrations else {KeyCommand.WATCH}
        first = lesson.question_feature == app.domain.features[0].name
        if phase is Phase.ASKING and first and app.groups.asked(app.domain, lesson)[1] is None:
            without.add(KeyCommand.BACK)
        commands = _possible(_IN_PHASE.get(phase, _LEAVE), app, without)
        return key_table(actions, (*PACE, *commands) if app.run is not None else commands)

    def questions_key(self, app: App) -> str:
        """Return the label of the key that asks the questions again; empty: not now."""
        table = self.table(app)
        known = KeyCommand.QUESTIONS in table.commands.values()
        return table.key(KeyCommand.QUESTIONS) if known else ''

    def ending_keys(self, app: App) -> tuple[str, str]:
        """Return the labels of the keys about ends: it can start again there; demonstrations."""
        table = _demonstrating(app)
        return table.key(KeyCommand.START_AGAIN), table.key(KeyCommand.DEMONSTRATIONS)

    def keys(self, app: App) -> Keys:
        phase = app.world.lesson.phase
        first = _question_keys(app) if phase is Phase.ASKING else []
        if phase is Phase.DEMONSTRATING:
            first = [(label(action.key), action.name) for action in app.domain.actions]
        again = f'can start again at its end: {"YES" if _can_start_again(app) else "no"}'
        words = {KeyCommand.START_AGAIN: again, **pace_words(app)}
        if phase is Phase.FINISHED:
            words |= {KeyCommand.BEGIN: 'show one more', KeyCommand.MENU: 'menu, next option'}
        return first + self.table(app).labelled(words)

    def _carry_out(self, command: KeyCommand, lesson: LessonView, app: App) -> None:
        match command:
            case KeyCommand.DONE | KeyCommand.NOT_HERE if app.run is not None:
                app.ask(SetControl(hold=True))
                app.say('The machine has stopped. Look at the board, then press the key again.')
            case KeyCommand.BEGIN:
                self._begin(app)
            case KeyCommand.DONE:
                self._done(app)
            case KeyCommand.NOT_HERE:
                self._verdict(Verdict.NOT_HERE, app)
            case KeyCommand.DISCARD:
                self._discard(app)
            case KeyCommand.UNDO:
                self._undo(lesson, app)
            case KeyCommand.DEMONSTRATIONS:
                app.ask(ListDemonstrations())
            case KeyCommand.WATCH:
                # Another start of the task in each episode; empty: where the game begins.
                episode, start = app.world.game.episode, ''
                if can_simulate(app.domain):
                    rng = generator(app.seed, 'watched start', app.participant, episode)
                    start = app.domain.encode(app.domain.reset(rng))
                self._watch(start, app)
            case KeyCommand.BACK:
                group, said = app.groups.asked(app.domain, lesson)
                first = group is not None and lesson.question_feature == group.features[0]
                if group is not None and first and said is not None:
                    app.groups.take_back(group)
                else:
                    app.ask(AnswerQuestion(lesson.question_id, back=True))
            case KeyCommand.START_AGAIN:
                app.can_start_again[lesson.option_name] = not _can_start_again(app)
            case KeyCommand.QUESTIONS:
                self._leave('Answer the questions again', self._ask_again, app)
            case KeyCommand.RUN:
                self.run(lesson.option_name, app)
            case KeyCommand.MENU:
                self._leave('Go to the menu', self.menu, app)
            case KeyCommand.HELP:
                app.show(HelpScreen(_help(app), self.again))
            case KeyCommand.QUIT:
                self._leave('Quit', lambda app: app.end(), app)
            case _:
                set_pace(command, app)

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
        title = f'The machine took the first {steps} steps. Are they part of what you show?'
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
            app.say('You have taken no step that can be undone.', bad=True)
        elif lesson.paused:
            app.say('Not now: the lesson is paused and could not begin again.', bad=True)
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
            app.say('There are no demonstrations yet.')
            return
        back = partial(self._show_demonstrations, shown)
        items = [
            Item(*_in_words(demo), partial(self._show_one, demo, back), demo.states)
            for demo in reversed(shown)
        ]
        app.show(ListScreen('Demonstrations, the newest first', items, back=self.again))

    def _show_one(self, demo: Demonstration, back: Callable[[App], None], app: App) -> None:
        watch, states = partial(self._watch, demo.states[0]), demo.states
        items = [Item('Watch the option from its start', 'and correct it', watch, states)]
        if not demo.withdrawn:
            note = 'it no longer counts, and its start comes again'
            items.append(Item('Delete it', note, partial(self._delete, demo.uuid), states))
        app.show(ListScreen(' '.join(_in_words(demo)), items, back))

    def _delete(self, uuid: str, app: App) -> None:
        """Go on, and withdraw a demonstration as soon as that is possible; empty: none."""
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
            question = f'{words}? This demonstration is discarded; everything else is saved.'
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


def _can_start_again(app: App) -> bool:
    """Return whether the next done says that the option could start again there."""
    return app.can_start_again.get(app.world.lesson.option_name, False)


def _question_keys(app: App) -> Keys:
    lesson, group = app.world.lesson, _open_group(app)
    keys = [('y', 'yes'), ('n', 'no' if group is None else 'no, to all of them')]
    if lesson.earlier_features:
        asked = {lesson.question_feature} if group is None else set(group.features)
        before = 'yes' if asked & set(lesson.earlier_features) else 'no'
        keys += [(label(ENTER), f'as before: {before}'), ('o', 'all others as before')]
    elif _can_skip(lesson):
        keys.append(('o', 'no to all others'))
    return keys


def _possible(
    commands: Sequence[KeyCommand], app: App, without: set[KeyCommand]
) -> list[KeyCommand]:
    """Return commands without some, and without undo where chance may end a step otherwise."""
    without = without if is_deterministic(app.domain) else {*without, KeyCommand.UNDO}
    return [command for command in commands if command not in without]


def _demonstrating(app: App) -> KeyTable:
    return key_table(app.domain.actions, _possible(_IN_PHASE[Phase.DEMONSTRATING], app, set()))


def _help(app: App) -> Keys:
    words = {KeyCommand.MENU: 'to the menu; a demonstration under way is discarded'}
    if app.world.lesson.phase is Phase.ASKING:
        return _question_keys(app) + key_table((), _IN_PHASE[Phase.ASKING]).help((), words)
    return _demonstrating(app).help(app.domain.actions, words)
