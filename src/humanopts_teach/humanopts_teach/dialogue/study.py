"""The dialogue of a study: a sequence of parts, one of which is teaching."""

from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
import math

from humanopts_teach.dialogue.app import App, Screen
from humanopts_teach.dialogue.consent import page
from humanopts_teach.dialogue.driving import PlayScreen
from humanopts_teach.dialogue.entry import end, TextScreen
from humanopts_teach.dialogue.keys import Command, Do, ENTER, LEFT, RIGHT
from humanopts_teach.dialogue.menu import opening
from humanopts_teach.dialogue.panel import GAP, Line, Page, Panel, Tone
from humanopts_teach.language import in_its_language
from humanopts_teach.lesson.requests import CancelRun, Phase, Request, SetControl, World
from humanopts_teach.study.events import (
    EventKind,
    FAILED,
    FINISHED,
    learned,
    LearnedOption,
    REFUSED,
    TIME,
)
from humanopts_teach.study.plan import Part, PartKind
from humanopts_teach.study.questions import Questionnaire
from humanopts_teach.study.record import OpenRecord

SIGN_SECONDS = 5.0  # period of keep-alive events: maximum time lost in a crash
_LAST = 'The time for this part is over: this {} is the last.'


class StudyApp(App):
    """The remaining parts of one condition; events are recorded immediately."""

    leaving = ('Finish teaching', 'continue with the study')
    cuts_plays = False  # all participants demonstrate options one by one, as in the paper

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

        :param parts: remaining parts, at least one.
        """
        super().__init__(Screen(), world, seed=seed)
        self._parts, self._record, self._code = list(parts), record, participant
        self._part: Part | None = None
        self._ends = math.inf  # s, end of the part's time limit
        self._signed = 0.0  # s, time of the last keep-alive event
        self._taught: tuple[LearnedOption, ...] = ()  # as last recorded
        self._announced = False  # whether the person was informed that the time is over

    @in_its_language
    def advance(self, now: float) -> Request | None:
        """Process queued requests and keys; end the part when its time is over."""
        if self._part is None and not self.ended:
            self._begin(now)
        if self._part is not None:
            if now >= self._signed + SIGN_SECONDS:
                self._signed = now
                with suppress(OSError):  # at most the time since the last event is lost
                    self._note_taught()
                    self.note('still there')
            if now >= self._ends:
                if self.world.lesson.phase is Phase.DEMONSTRATING:
                    if not self._announced:
                        self.say(
                            _LAST.format('run' if self.world.lesson.exam else 'demonstration')
                        )
                    self._announced = True
                elif self.waits_for is None:
                    self.end(TIME)
        return super().advance(now)

    def last_requests(self) -> list[Request]:
        """Also record that a part was left unfinished."""
        if self._part is not None:
            self._note_taught()
            self.note('part left')
            self._part = None
        return super().last_requests()

    def _begin(self, now: float) -> None:
        """Begin the next part; end the dialogue after the last one."""
        if not self._parts:
            self.ended = True
            return
        part = self._part = self._parts.pop(0)
        left = 60 * part.minutes - self._record.seconds_in(part.key)
        self._ends = now + left if part.minutes else math.inf
        self._signed, self._announced, self._taught = now, False, ()
        self.given_options = part.teach_buttons
        self.note('part began')
        self.show(_first_screen(self._part, self._code))

    def end(self, why: str = FINISHED) -> None:
        """
        End the part; the next call of ``advance`` begins the next part.

        Ctrl-C leaves the study, which can be continued later.
        """
        if self._part is None:
            return
        if self.run is not None:
            self.ask(CancelRun())
        if self.world.in_control:
            self.ask(SetControl(hold=False))
        self._note_taught()
        if why == FINISHED:
            why = self._record.check_attention(self._part)
        self.note('part ended', why=why)
        self.ended = why == FAILED
        self._part = None
        self._keys.clear()  # typed for the previous part
        self._outbox = deque(each for each in self._outbox if not self._is_anothers(each[0]))
        self.show(Screen())

    def _note_taught(self) -> None:
        """Record the options learned so far, if they have changed."""
        own = [each for each in self.world.summaries if each.participant == self._code]
        if self._part is not None and self._part.kind is PartKind.TEACH:
            options = learned(own)
            if options != self._taught:  # still empty right after a study is resumed
                self._taught = options
                self.note('learned', options=options)

    def note(self, kind: EventKind, **values: object) -> None:
        """Record an event of the part."""
        assert self._part is not None, 'an event between two parts'
        self._record.note(kind, self._part, **values)


@dataclass
class QuestionScreen(Screen):
    """A question with a rating scale."""

    questionnaire: Questionnaire
    index: int = 0  # index of the question
    value: int | None = field(default=None, init=False)  # current choice
    shows_board = False

    def panel(self, app: App) -> Panel:
        asked, points = self.questionnaire.items[self.index], self.questionnaire.points
        signs = ['●' if value == self.value else '○' for value in range(1, points + 1)]
        scale = Line(f'{asked.low}  {" ".join(signs)}  {asked.high}')
        count = f'question {self.index + 1} of {len(self.questionnaire.items)}'
        return Panel((Line(asked.text, strong=True), GAP, scale, GAP, Line(count, Tone.QUIET)))

    def commands(self, app: App) -> Sequence[Command]:
        points = self.questionnaire.points
        here = (points + 1) // 2 if self.value is None else self.value
        by = 0 if self.value is None else 1

        def choose(value: int) -> Do:
            return lambda app: setattr(self, 'value', min(max(value, 1), points))

        return [
            Command([LEFT], 'lower', choose(here - by)),
            Command([RIGHT], 'higher', choose(here + by)),
            Command([ENTER], 'accept', self._accept if self.value else None),
            *(Command(str(n), '', choose(n), label='') for n in range(1, min(points, 9) + 1)),
        ]

    def _accept(self, app: App) -> None:
        assert isinstance(app, StudyApp)
        assert self.value is not None
        items = self.questionnaire.items
        app.note(
            'answer',
            item=items[self.index].name,
            value=self.value,
            points=self.questionnaire.points,
        )
        if self.index + 1 < len(items):
            self.index, self.value = self.index + 1, None
        else:
            app.end()


def _first_screen(part: Part, participant: str) -> Screen:
    """Return the first screen of a part."""
    match part.kind:
        case PartKind.CONSENT:
            choices = [
                Command('y', 'I agree and take part', end),
                Command('n', 'I do not take part', _refuse),
            ]
            return page(Page(part.text), choices, part.reading)
        case PartKind.PAGE:
            choices = [Command([ENTER], 'continue', end)]
            return page(Page(part.text), choices, part.reading)
        case PartKind.PLAY | PartKind.PRACTICE:
            # No quit key: only Ctrl-C leaves the study.
            leave = 'continue with the study'
            return PlayScreen(end, 'Get to know the game', leave=leave, quits=False)
        case PartKind.BUTTONS:
            return _button(1, part.most)
        case PartKind.QUESTIONS:
            assert part.questions is not None
            return QuestionScreen(part.questions)
        case PartKind.TEACH:
            return opening(participant, ask=False)


def _refuse(app: App) -> None:
    assert isinstance(app, StudyApp)
    app.end(REFUSED)
    app.ended = True


def _button(rank: int, most: int) -> TextScreen:
    """Return the screen that asks for a button suggestion, as in section 4 of the paper."""

    def submit(text: str, app: App) -> None:
        assert isinstance(app, StudyApp)
        app.note('button', domain=app.domain.name, rank=rank, text=text)
        if rank < most:
            app.show(_button(rank + 1, most))
        else:
            app.end()

    return TextScreen(
        'Which button would make it easier and faster to win?',
        f'Say what it would do: go to ..., avoid ... Button {rank} of at most {most}.',
        submit=submit,
        back=end,
        back_words='no more',
    )
