"""The screen of one option's lesson: questions, demonstrations, criteria."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

from humanopts_env.domains.capabilities import FeatureGroup
from humanopts_teach.dialogue.app import App
from humanopts_teach.dialogue.entry import ConfirmScreen, HelpScreen, Keys, PlainScreen
from humanopts_teach.dialogue.keys import Command, ENTER, key_table, KeyTable, label, SPACE
from humanopts_teach.lesson.question_groups import GroupAnswer
from humanopts_teach.lesson.requests import (
    Answer,
    AnswerQuestion,
    BeginDemonstration,
    DefineOption,
    EndDemonstration,
    LessonView,
    Phase,
    Request,
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
        Command.TAKE_BACK,
        *_ALWAYS,
    ),
    Phase.READY: (Command.BEGIN, Command.TAKE_BACK, *_ALWAYS),
    Phase.FINISHED: (Command.RUN, Command.TAKE_BACK, *_ALWAYS),
}
_ELSE = (Command.MENU, Command.HELP, Command.QUIT)
_SHORT = {
    Command.DONE: 'done',
    Command.NOT_HERE: 'not here',
    Command.DISCARD: 'discard',
    Command.TAKE_BACK: 'undo the last',
    Command.QUESTIONS: 'questions',
    Command.BEGIN: 'begin',
    Command.RUN: 'run it',
    Command.MENU: 'menu',
    Command.HELP: 'help',
    Command.QUIT: 'quit',
}
_LONG = {
    Command.DONE: 'the option ends here: keep this demonstration',
    Command.START_AGAIN: 'with done: the option could start again where it ended, or could not',
    Command.NOT_HERE: 'the option makes no sense from this start; only before the first step',
    Command.DISCARD: 'forget this demonstration and try the same start again',
    Command.TAKE_BACK: 'take back the last demonstration that was kept, and show it anew',
    Command.QUESTIONS: 'answer again what the option depends on, Enter for an answer as before',
    Command.MENU: 'to the menu; a demonstration under way is discarded',
    Command.QUIT: 'leave; everything taught is saved, and is taken up again next time',
}


@dataclass
class LessonScreen(PlainScreen):
    """Teaching one option; what it shows follows the lesson's phase."""

    menu: Callable[[App], None]
    run: Callable[[str, App], None]
    automatic: bool = False  # the next demonstration begins by itself
    rest: bool = False  # all other questions are answered no, or as before
    answers_lesson: ClassVar[bool] = True

    def press(self, key: str, app: App) -> None:
        """Carry out one key as the phase has it."""
        lesson = app.world.lesson
        if lesson is None:
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
            self.automatic = True
        elif action is not None:
            app.drive(action)
        elif command is not None:
            self._carry_out(command, lesson, app)

    def tick(self, app: App) -> None:
        """Begin the next demonstration, or answer a question that needs no person."""
        lesson = app.world.lesson
        if lesson is None:
            return
        if self.rest and _can_skip(lesson):
            app.ask(_as_before(lesson))
        elif lesson.phase is Phase.ASKING:
            reply = app.groups.reply(app.domain, lesson)
            if reply is not None:
                app.ask(AnswerQuestion(lesson.question_id, reply))
        elif self.automatic and lesson.phase is Phase.READY:
            app.ask(BeginDemonstration())

    def replied(self, request: Request, answer: Answer, app: App) -> None:
        """Go on to the next start state, or stop where something was refused."""
        if isinstance(request, BeginDemonstration):
            self.automatic = False
        elif isinstance(request, AnswerQuestion) and not answer.carried_out:
            self.rest = False
            app.groups.forget()
        elif isinstance(request, WithdrawDemonstration) and answer.ok:
            self.automatic = True
        elif isinstance(request, EndDemonstration) and answer.ok:
            self.automatic = not app.world.paused

    def table(self, app: App) -> KeyTable:
        """Return the keys of the phase."""
        phase = _phase(app)
        actions = app.domain.actions if phase is Phase.DEMONSTRATING else ()
        commands = _IN_PHASE.get(phase, _ELSE)
        if app.world.lesson is None or not app.world.lesson.last_uuid:
            commands = tuple(c for c in commands if c is not Command.TAKE_BACK)
        return key_table(actions, commands)

    def questions_key(self, app: App) -> str:
        """Return the label of the key that asks the questions again; empty: not now."""
        table = self.table(app)
        known = Command.QUESTIONS in table.commands.values()
        return table.key(Command.QUESTIONS) if known else ''

    def ending_keys(self, app: App) -> tuple[str, str]:
        """Return the labels of the keys about ends: it can start again there; take it back."""
        table = _showing(app)
        return table.key(Command.START_AGAIN), table.key(Command.TAKE_BACK)

    def keys(self, app: App) -> Keys:
        """Return the keys of the phase and what they do."""
        phase, table = _phase(app), self.table(app)
        first = _question_keys(app) if phase is Phase.ASKING else []
        if phase is Phase.DEMONSTRATING:
            first = [(label(action.key), action.name) for action in app.domain.actions]
        again = f'can restart at its end: {"YES" if _can_start_again(app) else "no"}'
        words = _SHORT | {Command.START_AGAIN: again}
        return first + [(label(key), words[command]) for key, command in table.commands.items()]

    def _carry_out(self, command: Command, lesson: LessonView, app: App) -> None:
        def leave(words: str, go: Callable[[App], None]) -> None:
            self._leave(words, go, app)

        does: dict[Command, Callable[[], None]] = {
            Command.BEGIN: self._begin,
            Command.DONE: lambda: self._done(app),
            Command.NOT_HERE: lambda: self._verdict(Verdict.NOT_HERE, app),
            Command.DISCARD: lambda: self._verdict(Verdict.DISCARD, app),
            Command.TAKE_BACK: lambda: self._take_back(lesson, app),
            Command.START_AGAIN: lambda: self._toggle(lesson, app),
            Command.QUESTIONS: lambda: leave(
                'Answer the questions again', lambda app: self._ask_again(lesson, app)
            ),
            Command.RUN: lambda: self.run(lesson.option_name, app),
            Command.MENU: lambda: leave('Go to the menu', self.menu),
            Command.HELP: lambda: app.show(HelpScreen(_help(app), self._back)),
            Command.QUIT: lambda: leave('Quit', App.end),
        }
        does[command]()

    def _begin(self) -> None:
        self.automatic = True

    def _toggle(self, lesson: LessonView, app: App) -> None:
        app.can_start_again[lesson.option_name] = not _can_start_again(app)

    def _back(self, app: App) -> None:
        app.show(self)

    def _done(self, app: App) -> None:
        """Say done; ask once more where the last step had no effect."""
        effect = app.world.last_effect
        if effect is None or effect.changed:
            self._verdict(Verdict.DONE, app)
            return

        def affirm(app: App) -> None:
            app.show(self)
            self._verdict(Verdict.DONE, app)

        question = f'The last step had no effect ({effect.text}). Does the option end here?'
        app.show(ConfirmScreen(question, affirm, self._back))

    def _verdict(self, verdict: Verdict, app: App) -> None:
        if (game := app.world.game) is not None:
            again = _can_start_again(app) and verdict is Verdict.DONE
            app.ask(EndDemonstration(verdict, game.episode, game.step, again))

    def _take_back(self, lesson: LessonView, app: App) -> None:
        """Take back the newest demonstration, and discard the one under way; ask first."""

        def withdraw(app: App) -> None:
            app.show(self)
            if (game := app.world.game) is not None and _phase(app) is Phase.DEMONSTRATING:
                app.ask(EndDemonstration(Verdict.DISCARD, game.episode, game.step))
            app.ask(WithdrawDemonstration(lesson.last_uuid))

        under_way = lesson.phase is Phase.DEMONSTRATING
        last = 'the one before this' if under_way else 'the last demonstration'
        discarded = ' This one is discarded.' if under_way else ''
        question = (
            f'Take back {last}? It counts no more, and you show it anew from its start.{discarded}'
        )
        app.show(ConfirmScreen(question, withdraw, self._back))

    def _leave(self, words: str, go: Callable[[App], None], app: App) -> None:
        """Discard the demonstration under way and go; ask first if steps were taken."""
        game = app.world.game
        if _phase(app) is not Phase.DEMONSTRATING or game is None:
            go(app)
            return

        def discard(app: App) -> None:
            app.show(self)
            app.ask(EndDemonstration(Verdict.DISCARD, game.episode, game.step))
            go(app)

        if game.step:
            question = f'{words}? The demonstration under way is discarded; all else is saved.'
            app.show(ConfirmScreen(question, discard, self._back))
        else:
            discard(app)

    def _ask_again(self, lesson: LessonView, app: App) -> None:
        app.show(self)
        app.ask(DefineOption(lesson.option_name, ask_again=True))


def _can_skip(lesson: LessonView) -> bool:
    known = lesson.chosen_features or lesson.earlier_features
    return lesson.phase is Phase.ASKING and bool(known)


def _as_before(lesson: LessonView) -> AnswerQuestion:
    """Answer the open question as it was answered before; no, where it was not."""
    return AnswerQuestion(lesson.question_id, lesson.question_feature in lesson.earlier_features)


def _open_group(app: App) -> FeatureGroup | None:
    """Return the group that is asked about; None: no question is open, or it is of one feature."""
    lesson = app.world.lesson
    if lesson is None or lesson.phase is not Phase.ASKING:
        return None
    return app.groups.open_group(app.domain, lesson)


def _group_answer(key: str, lesson: LessonView) -> GroupAnswer | None:
    """Return the answer about a group that a key stands for; None: it stands for none."""
    if key == ENTER and lesson.earlier_features:
        return GroupAnswer.AS_BEFORE
    return {'y': GroupAnswer.EACH, 'n': GroupAnswer.NONE}.get(key.lower())


def _can_start_again(app: App) -> bool:
    """Return whether the next done says that the option could start again there."""
    lesson = app.world.lesson
    return lesson is not None and app.can_start_again.get(lesson.option_name, False)


def _question_keys(app: App) -> list[tuple[str, str]]:
    lesson, group = app.world.lesson, _open_group(app)
    keys = [('y', 'yes'), ('n', 'no' if group is None else 'no, to all of them')]
    if lesson is not None and lesson.earlier_features:
        asked = {lesson.question_feature} if group is None else set(group.features)
        before = 'yes' if asked & set(lesson.earlier_features) else 'no'
        keys += [(label(ENTER), f'as before: {before}'), ('o', 'all others as before')]
    elif lesson is not None and _can_skip(lesson):
        keys.append(('o', 'no to all others'))
    return keys


def _phase(app: App) -> Phase:
    return app.world.lesson.phase if app.world.lesson is not None else Phase.NO_SESSION


def _showing(app: App) -> KeyTable:
    return key_table(app.domain.actions, _IN_PHASE[Phase.DEMONSTRATING])


def _help(app: App) -> Sequence[tuple[str, str]]:
    leave = (label('ctrl-c'), 'leave at once')
    if _phase(app) is Phase.ASKING:
        table = key_table((), _ELSE)
        commands = [(label(key), _LONG.get(c, _SHORT[c])) for key, c in table.commands.items()]
        return [*_question_keys(app), *commands, leave]
    table = _showing(app)
    actions = [(label(action.key), action.description) for action in app.domain.actions]
    commands = [(label(key), _LONG[c]) for key, c in table.commands.items() if c in _LONG]
    return [*actions, *commands, leave]
