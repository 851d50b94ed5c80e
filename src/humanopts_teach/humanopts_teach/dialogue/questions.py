"""Screens of a questionnaire, one per question; an earlier answer can be changed."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
import math
from typing import Any, cast

from humanopts_teach.dialogue import keys
from humanopts_teach.dialogue.app import App, EARLIEST, Screen
from humanopts_teach.dialogue.entry import key_list, TextScreen
from humanopts_teach.dialogue.keys import Command, Do
from humanopts_teach.dialogue.panel import (
    Block,
    GAP,
    Line,
    OPTION_KEYS,
    Options,
    Panel,
    Rating,
    Tone,
    TypedText,
)
from humanopts_teach.language import _, Number
from humanopts_teach.study.questions import Question, QuestionKind, Questionnaire

_DIGITS = 25  # maximum number of characters of a number


@dataclass
class Asked:
    """
    The state of a questionnaire.

    :ivar note: callback that records an answer.
    :ivar answers: accepted answers by name; None: skipped.
    """

    questionnaire: Questionnaire
    note: Callable[..., object]
    at: int = 0  # index of the question
    answers: dict[str, Any] = field(default_factory=dict)

    @property
    def question(self) -> Question:
        """The current question."""
        return self.questionnaire.items[self.at]

    def screen(self) -> Screen:
        """Return a screen for the current question."""
        if self.question.kind in (QuestionKind.TEXT, QuestionKind.NUMBER):
            return _TextQuestion(self)
        return _ChoiceQuestion(self)

    def accept(self, value: Any, app: App) -> None:
        """Record an answer, and show the next question; end the part after the last one."""
        question, since = self.question, app.screen.first_shown or app.now
        rated = question.kind is QuestionKind.RATING
        scale = {'points': self.questionnaire.points} if rated else {}
        seconds = round(app.now - since, 3)
        self.note(item=question.name, value=value, seconds=seconds, **scale)
        self.answers[question.name] = value
        self.at += 1
        if self.at < len(self.questionnaire.items):
            app.show(self.screen())
        else:
            app.end()  # ends the part, not the dialogue

    def blocks(self, *answer: Block) -> Panel:
        """Return the panel of the question, with the current answer."""
        note = _('question {number} of {count}').format(
            number=self.at + 1, count=len(self.questionnaire.items)
        )
        if self.question.skippable:
            note += _('; you may skip it')
        lines = Line(_(self.question.text), strong=True), GAP, *answer, GAP, Line(note, Tone.QUIET)
        return Panel(lines)

    def back(self) -> Do | None:
        """Return a callback that shows the previous question; None: this is the first one."""

        def go_back(app: App) -> None:
            self.at -= 1
            app.show(self.screen())

        return go_back if self.at else None


class _ChoiceQuestion(Screen):
    """A rating, or a single or multiple choice: one press chooses, Enter accepts."""

    shows_board = False
    earliest = EARLIEST

    def __init__(self, asked: Asked) -> None:
        self._asked = asked
        given = asked.answers.get(asked.question.name)
        self.chosen = given if isinstance(given, tuple) else () if given is None else (given,)

    def panel(self, app: App) -> Panel:
        question, points = self._asked.question, self._asked.questionnaire.points
        if question.kind is QuestionKind.RATING:
            low, high = _(question.low), _(question.high)
            return self._asked.blocks(Rating(points, low, high, self._value))
        several = question.kind is QuestionKind.CHOICES
        chosen = frozenset(number - 1 for number in self.chosen)
        return self._asked.blocks(Options(question.options, chosen, several))

    def commands(self, app: App) -> Sequence[Command]:
        question = self._asked.question
        value = self.chosen if question.kind is QuestionKind.CHOICES else self._value
        words = _('skip') if question.skippable and not self.chosen else _('accept')
        accept = Command([keys.ENTER], words, lambda app: self._accept(value or None, app))
        back = Command([keys.BACKSPACE], _('previous question'), self._asked.back())
        clear = Command([keys.CLEAR], _('erase'), self._set(()), label='')
        helping = Command('?', _('help'), self._explain)
        if question.kind is QuestionKind.RATING:
            points, here = self._asked.questionnaire.points, self._value
            lower = here - 1 if here and here > 1 else 1 if here else points
            higher = min(here + 1, points) if here else 1
            digits = [
                Command(each, _('choose'), self._digit(int(each)), label='')
                for each in '1234567890'
            ]
            digits[0] = Command('1', _('choose'), self._digit(1), label=f'1-{points}')
            return [
                *digits,
                Command([keys.LEFT], _('lower'), self._set((lower,)), label=''),
                Command([keys.RIGHT], _('higher'), self._set((higher,)), label=''),
                *(accept, back, clear, helping),
            ]
        last = OPTION_KEYS[len(question.options) - 1]
        choices = [
            Command(
                key, _('choose'), self._choose(number), label='' if number > 1 else f'1-{last}'
            )
            for number, key in enumerate(OPTION_KEYS[: len(question.options)], start=1)
        ]
        return [*choices, accept, back, clear, helping]

    def _accept(self, value: Any, app: App) -> None:
        if value is None and not self._asked.question.skippable:
            app.say(_('Please choose an answer first.'), bad=True)
        else:
            self._asked.accept(value, app)

    @property
    def _value(self) -> int | None:
        return self.chosen[0] if self.chosen else None

    def _set(self, chosen: tuple[int, ...]) -> Do:
        return lambda app: setattr(self, 'chosen', chosen)

    def _digit(self, digit: int) -> Do:
        """Return a callback that chooses a point; two digits in a row form one number."""
        points = self._asked.questionnaire.points
        longer = 10 * (self._value or 0) + digit
        value = longer if self._value and longer <= points else digit
        return self._set((value,) if 1 <= value <= points else self.chosen)

    def _choose(self, number: int) -> Do:
        if self._asked.question.kind is QuestionKind.CHOICE:
            return self._set((number,))
        return self._set(tuple(sorted({*self.chosen} ^ {number})))

    def _explain(self, app: App) -> None:
        question, points = self._asked.question, self._asked.questionnaire.points
        rows = [(f'1-{OPTION_KEYS[len(question.options) - 1]}', _('choose an answer'))]
        if question.kind is QuestionKind.CHOICES:
            rows = [
                (rows[0][0], _('choose as many answers as you like; press again to undo a choice'))
            ]
        elif question.kind is QuestionKind.RATING:
            rows = [('1', _(question.low)), (str(points), _(question.high))]
            rows.append(('← →', _('lower, higher')))
        rows.append((keys.label(keys.ENTER), _('accept your answer')))
        rows.append((keys.label(keys.BACKSPACE), _('go back, and change an earlier answer')))
        app.show(key_list(_(question.text), rows, self.again))


class _TextQuestion(TextScreen):
    """A typed text or number; an empty answer skips the question if that is allowed."""

    shows_board = False
    earliest = EARLIEST

    def __init__(self, asked: Asked) -> None:
        question, given = asked.question, asked.answers.get(asked.question.name)
        number = question.kind is QuestionKind.NUMBER
        super().__init__(
            _(question.text),
            _limits(question) if number else '',
            '' if given is None else f'{Number(given):.15g}' if number else given,
            submit=self._submit,
            back=asked.back(),
            back_words=_('previous question'),
            max_characters=_DIGITS if number else question.max_characters,
            may_be_empty=question.skippable,
        )
        self._asked, self._edited = asked, True

    def panel(self, app: App) -> Panel:
        limits = [GAP, Line(self.explanation, Tone.QUIET)] if self.explanation else []
        return self._asked.blocks(TypedText(self.typed, self.max_characters), *limits)

    def _submit(self, text: str, app: App) -> None:
        question, value = self._asked.question, cast(Any, text or None)
        if text and question.kind is QuestionKind.NUMBER:
            value = _number(text)
            if value is None or not question.accepts(value, 0):
                app.say(_limits(question), bad=True)
                return
        self._asked.accept(value, app)


def _number(text: str) -> int | float | None:
    """Return the number in a text; None: it is not a number."""
    try:
        value = float(text.replace(',', '.'))
    except ValueError:
        return None
    return int(value) if math.isfinite(value) and value.is_integer() else value


def _limits(question: Question) -> str:
    """Describe the numbers that answer a question."""
    least, most = question.least, question.most
    words = {
        (True, True): _('a number from {least} to {most}'),
        (True, False): _('a number of at least {least}'),
        (False, True): _('a number up to {most}'),
        (False, False): _('a number'),
    }[least is not None, most is not None].format(
        least=f'{Number(least or 0):g}', most=f'{Number(most or 0):g}'
    )
    unit = f' ({question.unit})' if question.unit else ''
    return _('Please type {what}.').format(what=f'{words}{unit}')
