"""The dialogue of a study: a sequence of parts, one of which is teaching."""

from collections import deque
from collections.abc import Iterable, Sequence
from contextlib import suppress
from functools import partial
import math

from humanopts_teach.dialogue.app import App, Screen
from humanopts_teach.dialogue.consent import page
from humanopts_teach.dialogue.driving import PlayScreen
from humanopts_teach.dialogue.entry import end, Notice, TextScreen
from humanopts_teach.dialogue.keys import Command, END_OF_FILE, ENTER, INTERRUPT
from humanopts_teach.dialogue.menu import opening
from humanopts_teach.dialogue.panel import GAP, Line, Page
from humanopts_teach.dialogue.practice import PracticeScreen
from humanopts_teach.dialogue.questions import Asked
from humanopts_teach.language import _, in_its_language, N_, ngettext
from humanopts_teach.lesson.requests import (
    CancelRun,
    EndDemonstration,
    Phase,
    Request,
    SetControl,
    Verdict,
    World,
)
from humanopts_teach.study.events import (
    EventKind,
    FAILED,
    FINISHED,
    learned,
    LearnedOption,
    TIME,
)
from humanopts_teach.study.plan import Part, PartKind
from humanopts_teach.study.record import OpenRecord

SIGN_SECONDS = 5.0  # period of keep-alive events: maximum time lost in a crash
WARNING_SECONDS = 60.0  # from the inactivity warning to the end of the part
_IN_GAME = (PartKind.PLAY, PartKind.BUTTONS, PartKind.TEACH)  # parts in which the task is shown


class StudyApp(App):
    """The remaining parts of one condition; events are recorded immediately."""

    leaving = (N_('Finish teaching'), N_('continue with the study'))
    in_study = True  # all participants demonstrate options one by one, as in the paper

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
        self._parts, self._record, self.code = list(parts), record, participant
        self._part: Part | None = None
        self._ends = math.inf  # s, end of the part's time limit
        self._signed = 0.0  # s, time of the last keep-alive event
        self._taught: tuple[LearnedOption, ...] = ()  # as last recorded
        self._touched = 0.0  # s, time of the last key
        self._interrupted: Screen | None = None  # screen replaced by the inactivity warning

    @in_its_language
    def advance(self, now: float) -> Request | None:
        """Process queued requests and keys; end the part when its time is over."""
        if self._part is None and not self.ended:
            self._begin(now)
        if self._part is not None and not self.ended:
            if now >= self._signed + SIGN_SECONDS:
                self._signed = now
                with suppress(OSError):  # at most the time since the last event is lost
                    self._note_taught()
                    self.note('still there')
            self.clock = _time_left(self._ends - now)
            if now >= self._ends:
                if self.waits_for is None:
                    self.end(TIME)
            else:
                self._check_idle(now)
        return super().advance(now)

    def type(self, keys: Iterable[str], frame: int | None = None) -> None:
        """Accept keys; the first key after an inactivity warning only restores the screen."""
        keys = list(keys)
        if keys:
            silent, self._touched = self.now - self._touched, self.now
        if keys and self._interrupted is not None:
            self.note('idle', seconds=round(silent, 1))
            self.show(self._interrupted)
            self._interrupted = None
            keys = [key for key in keys if key in (INTERRUPT, END_OF_FILE)]
        super().type(keys, frame)

    def _check_idle(self, now: float) -> None:
        """Warn an inactive person, and leave the part if no key is pressed."""
        assert self._part is not None
        if self.run is not None:  # the person watches
            self._touched = now
        left = 60 * self._part.idle + WARNING_SECONDS - (now - self._touched)
        if not self._part.idle or left > WARNING_SECONDS:
            return
        self.clock = _time_left(left)
        if left <= 0:
            self.note('idle', seconds=round(now - self._touched, 1))
            self.ended = True
        elif self._interrupted is None:
            self._interrupted = self.screen
            self.show(_idle_screen())

    def last_requests(self) -> list[Request]:
        """Record an unfinished part, and return the requests of the base class."""
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
        self._signed, self._touched, self._taught = now, now, ()
        self.given_options, self.task = part.teach_buttons, part.task * (part.kind in _IN_GAME)
        again = any(each.part == part.key for each in self._record.of('part began'))
        self.note('part began')
        self.show(_first_screen(part, self))
        if again:
            self.say(_('Welcome back: finished work is kept; unfinished work begins again.'))

    def end(self, why: str = FINISHED) -> None:
        """
        End the part; the next call of ``advance`` begins the next part.

        An open demonstration is discarded. Ctrl-C leaves the study, which can be continued later.
        """
        if self._part is None:
            return
        lesson, game = self.world.lesson, self.world.game
        if why == TIME:
            self._drop()
            self._interrupted = None
            self.say(_('The time for this part is up.'))
        if self.run is not None:
            self.ask(CancelRun())
        if lesson.phase is Phase.DEMONSTRATING and lesson.participant == self.participant:
            self.note('demonstration cut')
            self.ask(EndDemonstration(Verdict.DISCARD, game.episode, game.step))
        if self.world.in_control:
            self.ask(SetControl(hold=False))
        self._note_taught()
        if why == FINISHED:
            why = self._record.check_attention(self._part)
        self.note('part ended', why=why)
        self.ended = why == FAILED
        self._part, self.clock, self.task = None, '', ''
        self._keys.clear()  # typed for the previous part
        self._outbox = deque(each for each in self._outbox if not self._is_anothers(each[0]))
        self.show(Screen())

    def leaving_question(self) -> str:
        """Return a confirmation question for leaving unlearned buttons; empty: none."""
        names = self.given_options or self.known_options
        known = {name: self.world.summary_of(self.code, name) for name in names}
        left = [name for name, each in known.items() if each is None or not each.learned]
        text = _('Not learned yet: {names}. Finish teaching? You cannot come back to it.')
        return text.format(names=', '.join(left)) if left else ''

    def _note_taught(self) -> None:
        """Record the options learned so far, if they have changed."""
        own = [each for each in self.world.summaries if each.participant == self.code]
        if self._part is not None and self._part.kind is PartKind.TEACH:
            options = learned(own)
            if options != self._taught:  # both are empty right after a study is resumed
                self._taught = options
                self.note('learned', options=options)

    def note(self, kind: EventKind, **values: object) -> None:
        """Record an event of the part."""
        assert self._part is not None, 'an event between two parts'
        self._record.note(kind, self._part, **values)


def _time_left(seconds: float) -> str:
    """Return the remaining time: minutes in the last five minutes, seconds in the last minute."""
    if seconds <= 60:
        count = max(math.ceil(seconds), 0)
        return ngettext('{count} second left', '{count} seconds left', count).format(count=count)
    if seconds > 300:
        return ''
    count = math.ceil(seconds / 60)
    return ngettext('{count} minute left', '{count} minutes left', count).format(count=count)


def _idle_screen() -> Screen:
    """Return the warning that no key was pressed; ``StudyApp.type`` handles its keys."""
    question = Line(_('Are you still there?'), strong=True)
    text = Line(_('If no key is pressed, the study pauses; it can be continued later.'))
    choices = [Command([ENTER], _('go on'), lambda app: None, label=_('any key'))]
    return Notice([question, GAP, text], choices, shows_board=False)


def _first_screen(part: Part, app: StudyApp) -> Screen:
    """Return the first screen of a part."""
    match part.kind:
        case PartKind.CONSENT:
            raise AssertionError('the consent comes before the game')
        case PartKind.PAGE:
            choices = [Command([ENTER], N_('continue'), end)]
            return page(Page(part.text), choices, part.reading)
        case PartKind.PRACTICE:
            return PracticeScreen(end)
        case PartKind.PLAY:
            leave = N_('continue with the study')
            return PlayScreen(end, N_('Get to know the game'), leave=leave)
        case PartKind.BUTTONS:
            return _button(1, part.most)
        case PartKind.QUESTIONS:
            assert part.questions is not None
            return Asked(part.questions, partial(app.note, 'answer')).screen()
        case PartKind.TEACH:
            return opening(app.code, ask=False)


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
        _('Which button would make it easier and faster to win?'),
        _('Say what it would do: go to ..., avoid ... Button {rank} of at most {most}.').format(
            rank=rank, most=most
        ),
        submit=submit,
        back=end,
        back_words=N_('no more'),
    )
