"""Somebody at the dialogue: presses keys, and answers the requests as a graph would."""

from dataclasses import replace
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.game import Transition
from humanopts_learner.options.criteria import FEWEST
from humanopts_learner.summary import Criterion, OptionSummary
from humanopts_teach.dialogue.app import App
from humanopts_teach.dialogue.menu import opening
from humanopts_teach.lesson.requests import (
    Answer,
    BeginDemonstration,
    Drive,
    LessonView,
    Phase,
    Request,
    RequestStatus,
    WithdrawDemonstration,
)
from humanopts_teach.terminal.drawing import frame

START = 'taxi 2,3 passenger R destination B'
AT_G = 'taxi 0,3 passenger G destination B'
NAME = 'go to passenger and pickup'
BOTTOM = '┗━━━┻━━━━━━━┻━━━━━━━┛'
CHOSEN = ('taxi_row', 'taxi_col', 'passenger_row', 'passenger_col')


class Person:
    """Presses keys, and answers the requests as a graph would."""

    def __init__(self, domain: Domain[Any]) -> None:
        self.app = App(opening('p1'))
        self.world = self.app.world
        self.world.domain, self.world.me = domain, 'me'
        self.world.game = Transition(episode=1, step=0, state=START)
        self.world.lesson = LessonView(Phase.NO_SESSION, budget=100)
        self.now = 0.0
        self.asked: list[Request] = []
        self.side = 24  # column where the panel beside the board begins

    def press(self, *keys: str) -> Request | None:
        """Look at the screen and type keys; return the request that they lead to."""
        self.app.drawn()
        self.app.type(keys)
        return self.look()

    def type(self, text: str) -> Request | None:
        """Type a text and Enter."""
        return self.press(*text, 'enter')

    def look(self) -> Request | None:
        """Let the app go on."""
        request = self.app.advance(self.now)
        if request is not None:
            self.asked.append(request)
        return request

    def answer(
        self, request: Request | None, ok: bool = True, text: str = '', **fields: Any
    ) -> Request | None:
        """Answer a request; return the next one."""
        assert request is not None
        uuid = request.uuid if isinstance(request, WithdrawDemonstration) else ''
        status = RequestStatus.OK if ok else RequestStatus.REFUSED
        answer = Answer(status, text, **{'episode': 1, 'uuid': uuid, **fields})
        self.app.replied(request, answer, self.now)
        return self.look()

    def lesson(self, phase: Phase, **fields: Any) -> Request | None:
        """Have the lesson announce where it stands; return the next request."""
        if phase is not Phase.DEMONSTRATING:
            fields = {'episode': 0, **fields}
        self.world.lesson = replace(self.world.lesson, phase=phase, **fields)
        return self.look()

    def names_option(self, phase: Phase, **fields: Any) -> 'Person':
        """Open a session and name an option, at whose phase the lesson then is."""
        opened = self.press('enter')
        self.lesson(Phase.NO_OPTION, participant='p1')
        self.answer(opened)
        defined = self.press('enter', *NAME, 'enter')
        self.lesson(phase, option_name=NAME, **fields)
        self.answer(defined)
        return self

    def asked_about(self, number: int, **fields: Any) -> Request | None:
        """Have the lesson ask about a feature of the domain, by its number from 1."""
        feature = self.app.domain.features[number - 1].name
        return self.lesson(Phase.ASKING, question_id=number, question_feature=feature, **fields)

    def begins(self, request: Request | None, episode: int) -> Request | None:
        """Have the lesson begin a demonstration that was asked for; return the next request."""
        assert isinstance(request, BeginDemonstration)
        self.world.update_game(Transition(episode=episode, state=request.start_state or START))
        self.lesson(Phase.DEMONSTRATING, episode=episode, machine_steps=0)
        return self.answer(request, episode=episode)

    def run_ends(self, text: str) -> None:
        """Have the run that is under way end."""
        assert self.app.run is not None
        self.app.run_ended(self.app.run, True, text)

    def game(self, **fields: Any) -> Request | None:
        """Have the game go on; return the next request."""
        self.world.update_game(replace(self.world.game, **fields))
        asked = self.app.waits_for
        if isinstance(asked, Drive):
            self.app.replied(asked, Answer(RequestStatus.OK, ''), self.now)
        return self.look()

    def sees(self, width: int = 80, height: int = 24) -> str:
        """Return the screen as text, in one line for each paragraph that was wrapped."""
        lines = frame(self.app, width, height)
        assert len(lines) == height
        return '\n'.join(lines)

    def sees_words(self, text: str) -> bool:
        """Tell whether the screen shows these words, however they are wrapped."""
        side = ' '.join(line[self.side :] for line in frame(self.app, 80, 24))
        whole = ' '.join(frame(self.app, 80, 24))
        return any(text in ' '.join(shown.split()) for shown in (side, whole))


def criteria(*values: tuple[str, float | None, float], **fields: Any) -> OptionSummary:
    """Return the progress of the option: the name, value and threshold of each criterion."""
    found = tuple(Criterion.of(*value) for value in values)
    return OptionSummary(
        NAME,
        'p1',
        **{'features': CHOSEN, 'n_demonstrations': FEWEST, 'more_needed': 6, **fields},
        criteria=found,
    )
