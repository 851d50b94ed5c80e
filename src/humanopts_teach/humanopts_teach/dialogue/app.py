"""
The dialogue's state machine: keys and events in, requests out.

Only one request is pending at a time; keys typed in the meantime are queued. A key that answers
the lesson counts only if the current question was on the screen when the key was pressed.
"""

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

from humanopts_env.domains.base import ActableDomain
from humanopts_teach.dialogue.keys import (
    Command,
    command_of,
    DOWN,
    END_OF_FILE,
    INTERRUPT,
    key_table,
    label,
    SPACE,
    UP,
)
from humanopts_teach.dialogue.panel import GAP, Line, Panel, Tone
from humanopts_teach.language import _, in_its_language, N_, translated
from humanopts_teach.lesson.question_groups import QuestionGroups
from humanopts_teach.lesson.requests import (
    ActionGoal,
    Answer,
    CancelRun,
    ChangeOption,
    DefineOption,
    Drive,
    EndDemonstration,
    LessonRequest,
    NewEpisode,
    Phase,
    Request,
    RequestStatus,
    server,
    SetControl,
    SetPace,
    settled,
    Verdict,
    WithdrawDemonstration,
    World,
)

REPLY_SECONDS = 5.0  # timeout for a node's answer
SETTLE_SECONDS = 1.0  # timeout for the latched topics to reflect the answer
EARLIEST = 0.3  # s, minimum display time of a text or question before keys count
MAX_KEYS = 128  # maximum number of queued keys; further keys are dropped
MAX_TYPED = 1024  # the same during text input; a page sends a whole text at once
_MAX_FRAMES = 64  # number of recent frames for which keys are accepted
_EARLY = N_('Please read this first; {key} was ignored.')
_PAUSED = N_('Not now: the lesson is paused; see the top of the screen.')


class Screen:
    """
    A screen: its contents and its key bindings.

    :cvar answers_lesson: keys answer the lesson, provided that its question has been displayed.
    :cvar shows_board: show the board next to the panel.
    :cvar hides_features: during a lesson, the board shows only the features the option depends on.
    :cvar claims_lesson: the screen may take over another participant's lesson.
    :cvar takes_text: the person types a text.
    :cvar earliest: minimum display time in s before keys count; 0: keys may be typed ahead.
    :ivar scroll: number of lines scrolled away in a terminal; None: the screen does not scroll.
    :ivar first_shown: monotonic time in s at which it was first displayed; None: not yet.
    """

    answers_lesson: bool = False
    shows_board: bool = True
    hides_features: bool = False
    claims_lesson: bool = False
    takes_text: bool = False
    earliest: float = 0.0
    scroll: int | None = None
    first_shown: float | None = None

    @property
    def state(self) -> str:
        """The state to draw, in the domain's notation; empty: the game's current state."""
        return ''

    def panel(self, app: 'App') -> Panel:
        """Return the contents of the screen apart from the board."""
        return Panel()

    def explain(self, app: 'App') -> str:
        """Return the explanation that the help shows besides the keys; empty: none."""
        return ''

    def commands(self, app: 'App') -> Sequence[Command]:
        """Return the available commands, in display order."""
        return ()

    def plays(self, app: 'App') -> bool:
        """Return whether the game is being played."""
        return False

    def press(self, key: str, app: 'App') -> None:
        """Run the command bound to a key."""
        command = command_of(key, key_table(self.commands(app)))
        if command is None:
            self.other_key(key, app)
        elif command.do is not None:
            command.do(app)

    def other_key(self, key: str, app: 'App') -> None:
        """Handle a key that is not bound to a command: a digit repeats the next action."""
        if key.isdecimal() and self.plays(app):
            app.times = f'{app.times}{key}'.lstrip('0')[:2]
            app.say(_('{count} times: now press an action key.').format(count=app.times or 0))

    def refused(self, app: 'App') -> None:
        """Handle a request that was not carried out."""

    def run_ended(self, run: ActionGoal, well: bool, app: 'App') -> None:
        """Handle the end of a run."""

    def tick(self, app: 'App') -> None:
        """Run automatic actions while no request is pending."""

    def again(self, app: 'App') -> None:
        """Return to this screen."""
        app.show(self)


@dataclass(frozen=True, slots=True)
class _Seen:
    """The contents of a frame."""

    asked_for: object = None  # the lesson's open question
    screen: object = None  # None: any screen


_FORGOTTEN = _Seen(object(), object())  # an outdated frame; its keys are ignored
Then = Callable[[Answer], object]


@dataclass
class _Waiting:
    request: Request
    then: Then | None
    until: float  # s, deadline
    answer: Answer | None = None


class App:
    """The state and logic of the dialogue."""

    leaving: ClassVar[tuple[str, str]] = (
        N_('Quit'),
        N_('everything taught is saved'),
    )  # menu item
    needs_game: ClassVar[bool] = True  # nothing is shown before the game is known
    in_study: ClassVar[bool] = False  # no quit key, no cutting of plays, no name of the session

    def __init__(self, first: Screen, world: World | None = None, *, seed: int = 0) -> None:
        self.world = world or World()
        self.seed = seed
        self.participant = ''
        self.known_options: tuple[str, ...] = ()  # in order of creation
        self.given_options: tuple[str, ...] = ()  # to be taught; empty: the person names them
        self.message = GAP
        self.clock = ''  # remaining time; empty: not shown
        self.task = ''  # what the person should do; empty: not shown
        self.screen = first
        self.run: ActionGoal | None = None  # active run
        self.run_text = ''  # progress of the run
        self.next_start = ''  # chosen start of the next demonstration; empty: none
        self.groups = QuestionGroups()
        self.choice_columns: dict[str, tuple[str, ...]] = {}  # of plans, by participant
        self.can_start_again: dict[str, bool] = {}  # latest setting of each option
        self.times = ''  # digits typed before an action; empty: take it once
        self.ended = False
        self.now = 0.0  # monotonic time of the last ``advance``, s
        self.language = ''  # of its texts, as in ``speaking``
        self.pictures = True  # show the world; False: only a table of its features
        self.leave_hint = N_('Ctrl-C quits')  # advice to the person when nodes are missing
        self._frame = 0  # number of the latest frame
        self._seen: dict[int, _Seen] = {}  # by frame number
        self._displayed: object = None  # screen of the last frame that the person saw
        self._outbox: deque[tuple[Request, Then | None]] = deque()
        self._keys: deque[tuple[str, _Seen]] = deque()  # each with the frame seen when pressed
        self._waiting: _Waiting | None = None
        self._stops = False  # the robot must stop at once
        self._owned = False  # this participant has owned the lesson
        self._displaced = first  # shown when another participant takes over the lesson

    @property
    def domain(self) -> ActableDomain:
        """The domain; screens that need it are shown only when it is known."""
        assert self.world.domain is not None
        return self.world.domain

    def leaving_question(self) -> str:
        """Return a confirmation question for leaving the dialogue by the menu; empty: none."""
        return ''

    @property
    def waits_for(self) -> Request | None:
        """The pending request."""
        return self._waiting.request if self._waiting is not None else None

    @property
    def shown(self) -> tuple[object, ...]:
        """The values that require a new frame when they change, besides world and keys."""
        missing = tuple(self.world.missing)
        screen, state = self.screen, self.screen.state
        running = self.run, self.run_text, self.waits_for
        return screen, state, self.message, self.clock, running, missing

    def show(self, screen: Screen) -> None:
        """Switch to another screen."""
        self.screen = screen

    def say(self, text: str, *, bad: bool = False) -> None:
        """Show the person a message."""
        self.message = Line(text, Tone.BAD if bad else Tone.GOOD)

    def ask(self, *requests: Request, then: Then | None = None) -> None:
        """
        Make requests one after another; if one fails, drop the rest.

        :param then: callback for the answer to the last request, if it was carried out.
        """
        *before, last = requests
        self._outbox.extend((request, None) for request in before)
        self._outbox.append((last, then))

    def drive(self, action: str) -> None:
        """
        Take a primitive action on the person's behalf; between episodes, only take control.

        A number typed first repeats the action until a step is refused. A robot can move between
        episodes, too: the next episode begins at its current state.
        """
        game, shows = self.world.game, self.world.lesson.phase is Phase.DEMONSTRATING
        if self.world.robot and not game.open and not shows:
            self.ask(NewEpisode(self.seed), then=lambda answer: self.drive(action))
        elif game.open:
            steps = range(game.step, game.step + int(self.times or 1))
            self.ask(*(Drive(action, game.episode, step) for step in steps))
        elif self.run is not None:
            self.ask(SetControl(hold=True))
        else:
            self.say(_('The episode is over: no more steps can be taken.'), bad=True)

    def actions(self) -> list[Command]:
        """Return the commands for primitive actions."""
        actions = [
            Command(
                [a.key],
                translated(a.name),
                partial(App.drive, action=a.name),
                translated(a.description),
            )
            for a in self.domain.actions
        ]
        free = not any(a.key.isdecimal() for a in self.domain.actions)
        text = _('a number before an action repeats it: 1 2 → takes 12 steps')
        repeat = Command(
            ['1-9'], _('repeat'), (lambda app: None) if free else None, text, label=''
        )
        return [*actions, repeat]

    def claim_lesson(self, participant: str, displaced: Screen) -> None:
        """
        Act on behalf of this participant from now on.

        :param displaced: screen to show when another participant takes over the lesson.
        """
        self.participant, self._displaced, self._owned = participant, displaced, False

    def end(self) -> None:
        """Leave the dialogue. Subclasses may override this to continue."""
        self.ended = True

    @in_its_language
    def type(self, keys: Iterable[str], frame: int | None = None) -> None:
        """
        Queue key presses; Ctrl-C, and Space with a robot, take effect immediately.

        During an action of a robot, its key queues one repetition, and the key of another action
        ends it. The current time is that of the last ``advance``.

        :param keys: pressed keys; none: only report the frame as displayed.
        :param frame: frame on which the keys were pressed; they count only while its screen is
            shown. None: the latest frame; typing ahead for later screens is allowed.
        """
        if frame is None:
            seen = self._seen.get(self._frame, _Seen())
        else:
            seen = self._seen.get(frame, _FORGOTTEN)
        self._displayed = seen.screen
        since, earliest = self.screen.first_shown, self.screen.earliest
        early = earliest and (since is None or self.now < since + earliest)
        if frame is None and not earliest:
            seen = replace(seen, screen=None)
        for key in keys:
            if key in (INTERRUPT, END_OF_FILE):
                self.ended = True
                continue
            moves = self.run is not None or bool(self.world.progress.action)
            if key == SPACE and self.world.robot and (moves or not self.screen.takes_text):
                self.stop()
                continue
            if early and key not in (UP, DOWN):
                self.say(_(_EARLY).format(key=label(key)))
                continue
            if self._lasts is not None and (action := self._action_of(key)):
                if action != self._lasts.action:
                    self._drop()
                    self._waiting = None
                elif any(queued == key for queued, seen in self._keys):
                    continue
            limit = MAX_TYPED if self.screen.takes_text else MAX_KEYS
            if key and len(self._keys) < limit:
                self._keys.append((key, seen))

    def stop(self) -> None:
        """Stop the robot at once and take control; drop queued requests and keys."""
        self._drop()
        if self._lasts is not None:
            self._waiting = None
        self._stops = True

    @property
    def _lasts(self) -> Drive | None:
        """The pending action of a robot, which may take a while; None: none."""
        request = self.waits_for
        return (
            request if isinstance(request, Drive) and self.world.longest(request.action) else None
        )

    def _action_of(self, key: str) -> str:
        """Return the action bound to a key; empty: no action, or the screen does not drive."""
        if not self.screen.plays(self):
            return ''
        command = command_of(key, key_table(self.screen.commands(self)))
        names = {translated(action.name): action.name for action in self.domain.actions}
        return names.get(command.words, '') if command is not None else ''

    def drawn(self) -> int:
        """
        Record that a frame was displayed: later keys respond to its question.

        :return: frame number.
        """
        self._frame += 1
        self._seen[self._frame] = _Seen(self._asked_for, self.screen)
        self._seen.pop(self._frame - _MAX_FRAMES, None)
        return self._frame

    @in_its_language
    def advance(self, now: float) -> Request | None:
        """
        Process queued requests and keys as far as possible.

        :param now: monotonic time in seconds.
        :return: the next request to make; pass its answer to ``replied``. A ``Drive`` without
            action stops a robot even if another request is pending, and is not answered.
        """
        self.now = now
        if self.screen.first_shown is None and self._displayed is self.screen:
            self.screen.first_shown = now
        self._check_waiting(now)
        self._owned |= self.world.lesson.participant == self.participant
        while not self.ended:
            if self._stops:
                self._stops = False
                self.say(_('Stopped. You have control.'))
                return Drive('', self.world.game.episode, self.world.game.step)
            if self._waiting is not None:
                break
            if self._outbox:
                request, then = self._outbox.popleft()
                if self._is_anothers(request):
                    self._yield_lesson()
                    continue
                lasts = self.world.longest(request.action) if isinstance(request, Drive) else 0.0
                self._waiting = _Waiting(request, then, now + REPLY_SECONDS + lasts)
                return request
            if self._keys:
                self.message = GAP
                key, seen = self._keys.popleft()
                given = seen.screen is not None or self.screen.earliest > 0
                other = given and seen.screen is not self.screen
                if other or (self.screen.answers_lesson and seen.asked_for != self._asked_for):
                    self.say(
                        _('{key} was ignored: it was pressed before this screen appeared.').format(
                            key=label(key)
                        )
                    )
                else:
                    self.screen.press(key, self)
                    if not key.isdecimal():
                        self.times = ''
                continue
            self.screen.tick(self)
            if not self._outbox:
                break
        return None

    @in_its_language
    def replied(self, request: Request, answer: Answer, now: float) -> None:
        """Accept the answer to the pending request; ignore any other answer as late."""
        waiting = self._waiting
        if waiting is None or waiting.request is not request:
            return
        waiting.answer = replace(answer, detail=_words(request, answer))
        waiting.until = now + SETTLE_SECONDS
        if answer.ok and isinstance(request, ActionGoal):
            self.run, self.run_text = request, ''
            self.world.running = ''
        self._check_waiting(now)

    @in_its_language
    def run_ended(self, run: ActionGoal, well: bool, text: str) -> None:
        """Show how the active run ended; ignore other runs."""
        if self.run is run:
            self.run = None
            self.say(translated(text), bad=not well)
            self.resume_machine()
            self.screen.run_ended(run, well, self)

    def release(self) -> list[Request]:
        """
        Return the requests that let the machine move.

        A terminal that lets a robot move becomes its supervisor, and must have had control before.
        """
        world = self.world
        takes = world.robot and (world.locked or world.supervisor != world.me)
        return [*([SetControl(hold=True)] if takes else []), SetControl(hold=False)]

    def resume_machine(self) -> None:
        """Resume the machine if it is paused."""
        if self.world.paused_by:
            self.ask(SetPace(self.world.step_period, paused=False))

    def lost_server(self) -> None:
        """End the active run because its server is gone."""
        if self.run is not None:
            gone = _('{node} is gone.').format(node=server(type(self.run)))
            self.run_ended(self.run, False, gone)

    def last_requests(self) -> list[Request]:
        """Return the requests that clean up when the dialogue ends."""
        lesson, game = self.world.lesson, self.world.game
        is_own_lesson = lesson.participant == self.participant
        requests: list[Request] = []
        if self.run is not None:
            requests.append(CancelRun())
        if is_own_lesson and lesson.phase is Phase.DEMONSTRATING:
            requests.append(EndDemonstration(Verdict.DISCARD, game.episode, game.step))
        if self.world.robot:  # it is locked when this terminal leaves
            requests += [Drive('', game.episode, game.step)] if self.world.progress.action else []
        elif self.world.in_control:
            requests.append(SetControl(hold=False))
        return requests

    def _is_anothers(self, request: Request) -> bool:
        """Return whether a request would affect a lesson that another participant now owns."""
        lesson = self.world.lesson
        if not self._owned or self.screen.claims_lesson or lesson.participant == self.participant:
            return False
        moves = isinstance(request, Drive | NewEpisode | ActionGoal) or request == SetControl(
            hold=True
        )
        shows = lesson.phase is Phase.DEMONSTRATING
        return isinstance(request, LessonRequest) or (moves and shows)

    def _yield_lesson(self) -> None:
        """Yield the lesson and the game to another participant, and inform the person."""
        self._drop()
        if self.run is not None:
            self.ask(CancelRun())
        if self.world.paused_by == self.world.me:
            self.resume_machine()
        if self.world.in_control:
            self.ask(SetControl(hold=False))
        other = self.world.lesson.participant
        self.say(
            _('{participant} is teaching now.').format(participant=other)
            if other
            else _('The lesson was restarted.'),
            bad=True,
        )
        self.show(self._displaced)

    def _drop(self) -> None:
        """Drop all queued requests and keys."""
        self._outbox.clear()
        self._keys.clear()

    @property
    def _asked_for(self) -> object:
        """A key that identifies the open question or demonstration of the lesson."""
        lesson, domain = self.world.lesson, self.world.domain
        if domain is None:
            return None
        group = self.groups.open_group(domain, lesson)
        return lesson.phase, lesson.option_name, lesson.question_id, group, lesson.episode

    def _check_waiting(self, now: float) -> None:
        """Finish the pending request when it is answered and settled, or has timed out."""
        waiting = self._waiting
        if waiting is None:
            return
        request, answer, late = waiting.request, waiting.answer, now >= waiting.until
        if answer is None:
            if not late:
                return
            silent = _('The {node} is not responding.').format(node=server(type(request)))
            answer = Answer(RequestStatus.REFUSED, silent)
        elif answer.carried_out and not late and not settled(request, answer, self.world):
            return
        self._waiting, done = None, answer.carried_out
        if answer.detail or not done:
            self.say(answer.detail, bad=not done)
        if done:
            if waiting.then is not None:
                waiting.then(answer)
            return
        self._drop()
        if isinstance(request, Drive) and self.run is not None:
            self.ask(SetControl(hold=True))  # the machine was faster than the person
        self.screen.refused(self)


def _words(request: Request, answer: Answer) -> str:
    """Return the part of an answer to show the person; empty: nothing."""
    if answer.status is RequestStatus.PAUSED:
        return _(_PAUSED)
    if isinstance(request, Drive) and not answer.ok:
        return f'{translated(request.action)}: {translated(answer.detail)}'
    if answer.ok and not isinstance(request, DefineOption | WithdrawDemonstration | ChangeOption):
        return ''
    return translated(answer.detail)
