"""The dialogue of a study: one part after the other, of which teaching is one."""

from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
import math
from typing import Any, ClassVar

from humanopts_teach.dialogue.app import App, Screen
from humanopts_teach.dialogue.driving import PlayScreen
from humanopts_teach.dialogue.entry import TextScreen
from humanopts_teach.dialogue.keys import ENTER, KeyCommand, Keys, label, LEFT, RIGHT
from humanopts_teach.dialogue.menu import opening
from humanopts_teach.lesson.requests import CancelRun, Phase, Request, SetControl, World
from humanopts_teach.study.events import (
    Answered,
    ButtonSuggested,
    FINISHED,
    OptionsLearned,
    PartBegan,
    PartEnded,
    PartEvent,
    PartLeft,
    REFUSED,
    SignOfLife,
    TIME,
)
from humanopts_teach.study.plan import Part, PartKind, Question, Questionnaire
from humanopts_teach.study.record import learned_rows, OpenRecord

SIGN_SECONDS = 5.0  # between signs of life: what a crash can take of the time at a part
_LAST = 'The time for this part is over: this demonstration is the last.'


class StudyApp(App):
    """The parts that a participant has left in one condition; what is done is noted at once."""

    leaving = ('Finish teaching', 'go on with the study')

    def __init__(
        self,
        parts: Sequence[Part],
        record: OpenRecord,
        participant: str,
        world: World,
        *,
        seed: int,
    ) -> None:
        """
        Start before the first part.

        :param parts: one or more.
        """
        super().__init__(Screen(), world, seed=seed)
        self._parts, self._record, self._code = list(parts), record, participant
        self._part: Part | None = None
        self._ends = math.inf  # s, when the time of the part is over
        self._signed = 0.0  # s, when the last sign of life was noted
        self._taught: list[dict[str, Any]] = []  # what was noted last of what was learned
        self._announced = False  # that its time is over

    def advance(self, now: float) -> Request | None:
        """Carry out what can be carried out now; end a part whose time is over."""
        if self._part is None and not self.ended:
            self._begin(now)
        if self._part is not None:
            if now >= self._signed + SIGN_SECONDS:
                self._signed = now
                with suppress(OSError):  # no more than the time since the last one is lost
                    self._note_taught()
                    self._note(SignOfLife)
            if now >= self._ends:
                if self.world.lesson.phase is Phase.DEMONSTRATING:
                    self._announce_last()
                elif self.waits_for is None:
                    self._end_part(TIME)
        return super().advance(now)

    def last_requests(self) -> list[Request]:
        """Note that a part is left in its middle, too."""
        if self._part is not None:
            self._note_taught()
            self._note(PartLeft)
            self._part = None
        return super().last_requests()

    def end(self) -> None:
        """Go on with the next part; Ctrl-C leaves the study, to be gone on with later."""
        self._end_part(FINISHED)

    def refuse(self) -> None:
        """End the study: the person does not agree to take part."""
        self._end_part(REFUSED)
        self.ended = True

    def answer(self, item: str, value: int, points: int) -> None:
        """Note the answer to a question."""
        self._note(Answered, item=item, value=value, points=points)

    def suggest(self, rank: int, text: str) -> None:
        """Note a button that the person suggests."""
        self._note(ButtonSuggested, domain=self.domain.name, rank=rank, text=text)

    def _begin(self, now: float) -> None:
        """Begin the next part; after the last, end."""
        if not self._parts:
            self.ended = True
            return
        part = self._part = self._parts.pop(0)
        left = 60 * part.minutes - self._record.seconds_in(part.key)
        self._ends = now + left if part.minutes else math.inf
        self._signed, self._announced, self._taught = now, False, []
        self._note(PartBegan, kind=part.kind)
        self.show(_first_screen(self._part, self._code))

    def _announce_last(self) -> None:
        """Say once that the time is over."""
        if not self._announced:
            self.say(_LAST)
        self._announced = True

    def _end_part(self, why: str) -> None:
        """End the part; the next one begins in the next turn."""
        if self._part is None:
            return
        if self.run is not None:
            self.ask(CancelRun())
        if self.world.i_drive:
            self.ask(SetControl(hold=False))
        self._note_taught()
        self._note(PartEnded, kind=self._part.kind, why=why)
        self._part = None
        self._keys.clear()  # typed for what was shown
        self._outbox = deque(each for each in self._outbox if not self._is_anothers(each))
        self.show(Screen())

    def _note_taught(self) -> None:
        """Note what was taught so far, if there is anything new."""
        mine = [each for each in self.world.summaries if each.participant == self._code]
        if self._part is not None and self._part.kind is PartKind.TEACH:
            rows = learned_rows(mine)
            if rows != self._taught:  # none are known yet right after a return
                self._taught = rows
                self._note(OptionsLearned, options=rows)

    def _note(self, kind: type[PartEvent], /, **values: object) -> None:
        assert self._part is not None, 'something was noted between two parts'
        where = {'part': self._part.key, 'condition': self._part.condition}
        self._record.note(kind, **where, **values)


@dataclass
class PageScreen(Screen):
    """A page that the person reads."""

    shows_board: ClassVar[bool] = False
    text: str  # Markdown
    asks: bool = False  # whether the person agrees

    def press(self, key: str, app: App) -> None:
        assert isinstance(app, StudyApp)
        if key.lower() == 'y' if self.asks else key == ENTER:
            app.end()
        elif self.asks and key.lower() == 'n':
            app.refuse()

    def keys(self, app: App) -> Keys:
        if self.asks:
            return [('y', 'I agree and take part'), ('n', 'I do not take part')]
        return [('Enter', 'go on')]


@dataclass
class FreePlayScreen(PlayScreen):
    """The person gets to know the game; Escape goes on with the study."""

    # Only Ctrl-C leaves the study.
    commands: ClassVar[Sequence[KeyCommand]] = (
        KeyCommand.NEW_START,
        KeyCommand.MENU,
        KeyCommand.HELP,
    )
    words: ClassVar[Mapping[KeyCommand, str]] = {KeyCommand.MENU: 'go on with the study'}


@dataclass
class QuestionScreen(Screen):
    """A question that is answered on a scale."""

    shows_board: ClassVar[bool] = False
    questionnaire: Questionnaire
    index: int = 0  # of the question
    value: int | None = field(default=None, init=False)  # chosen so far

    @property
    def question(self) -> Question:
        """The question that is shown."""
        return self.questionnaire.items[self.index]

    def press(self, key: str, app: App) -> None:
        assert isinstance(app, StudyApp)
        points = self.questionnaire.points
        if key in (LEFT, RIGHT):
            middle = (points + 1) // 2
            moved = middle if self.value is None else self.value + (1 if key == RIGHT else -1)
            self.value = min(max(moved, 1), points)
        elif key.isdigit() and 1 <= int(key) <= min(points, 9):
            self.value = int(key)
        elif key == ENTER and self.value is not None:
            app.answer(self.question.name, self.value, points)
            self.index, self.value = self.index + 1, None
            if self.index == len(self.questionnaire.items):
                self.index -= 1
                app.end()

    def keys(self, app: App) -> Keys:
        accept = [('Enter', 'accept')] if self.value is not None else []
        return [(label(LEFT), 'lower'), (label(RIGHT), 'higher'), *accept]


def _first_screen(part: Part, participant: str) -> Screen:
    """Return the screen with which a part begins."""
    if part.kind in (PartKind.CONSENT, PartKind.PAGE):
        return PageScreen(part.text, asks=part.kind is PartKind.CONSENT)
    if part.kind is PartKind.PLAY:
        return FreePlayScreen(menu=lambda app: app.end(), title='Get to know the game')
    if part.kind is PartKind.BUTTONS:
        return _button(1, part.most)
    if part.questions is not None:
        return QuestionScreen(part.questions)
    return opening(participant, ask=False)


def _button(rank: int, most: int) -> TextScreen:
    """Return the screen that asks for a button, as in section 4 of the paper."""

    def submit(text: str, app: App) -> None:
        assert isinstance(app, StudyApp)
        app.suggest(rank, text)
        if rank < most:
            app.show(_button(rank + 1, most))
        else:
            app.end()

    return TextScreen(
        'Which button would make it easier and faster to win?',
        f'Say what it would do: go to ..., avoid ... Button {rank} of at most {most}.',
        submit=submit,
        back=lambda app: app.end(),
        back_words='no more',
    )
