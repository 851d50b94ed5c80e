"""
The teaching session as a state machine (paper, sections 5 and 6).

Every method takes one request or one piece of news, and leaves the lesson in a phase from which it
can go on. What the person said is in the store before a method answers OK.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from humanopts_env.domains.base import Domain, DomainError
from humanopts_env.game import Transition
from humanopts_learner.demonstrations import (
    check_demonstration,
    Demonstration,
    DemonstrationError,
)
from humanopts_teach.demos.store import DemonstrationStore
from humanopts_teach.demos.trace import Trace
from humanopts_teach.dialogue.answers import Answer, LessonView, Phase, Progress, Status, Verdict
from humanopts_teach.dialogue.collecting import Attempt, build, Label, objection
from humanopts_teach.dialogue.hints import hint
from humanopts_teach.dialogue.history import OptionHistory
from humanopts_teach.dialogue.learning import Learning
from humanopts_teach.dialogue.questions import question_text
from humanopts_teach.dialogue.session_log import SessionLog
from humanopts_teach.dialogue.start_states import StartDraws, StartStates

_UNRECORDED = 'on disk, but not in this recording: the next one has it'


@dataclass(frozen=True, slots=True)
class LessonRules:
    """How start states are drawn, and when the lesson on an option ends."""

    strategy: str = 'random'  # shown; ``StartStates`` carries it out
    budget: int = 100  # the most that is asked for one option, "not here" answers included
    seed: int = 0


class Lesson:
    """One participant at a time, one option at a time, one demonstration at a time."""

    def __init__(
        self,
        domain: Domain[Any],
        store: DemonstrationStore,
        starts: StartStates,
        rules: LessonRules,
        *,
        clock: Callable[[], float],
        today: Callable[[], str],
    ) -> None:
        """
        Begin without a session.

        :param clock: seconds, never going back.
        :param today: the date as YYYYMMDD, for session codes.
        """
        self._domain = domain
        self._draws = StartDraws(domain, starts, rules.seed)
        self._rules = rules
        self._clock = clock
        self._notebook = SessionLog(domain, store, today)
        self._option: OptionHistory | None = None
        self._trace = Trace()
        self._attempt: Attempt | None = None
        self._again = ''  # start state of a demonstration that came to nothing
        self._preparing = False  # game was asked for an episode and has not answered
        self._learning = Learning()
        self._done = False  # criteria met, and the strategy has nothing left to ask
        self._notice = ''
        self._paused = ''  # why nothing new can be begun; empty: it can

    # What can be read.

    @property
    def phase(self) -> Phase:
        """Where the lesson stands."""
        if not self._notebook.participant:
            return Phase.NO_SESSION
        if self._option is None:
            return Phase.NO_OPTION
        if self._attempt is not None:
            return Phase.DEMONSTRATING
        if self._option.questions.open is not None:
            return Phase.ASKING
        if self._learning.awaited is not None:
            return Phase.LEARNING
        return Phase.FINISHED if self._done or self._spent else Phase.READY

    def demonstrations(self) -> list[Demonstration]:
        """
        Return all that anybody has shown in this domain, in the order of the store.

        Of one that was taken back there is only the word that it is withdrawn.
        """
        return self._notebook.demonstrations()

    @property
    def awaited(self) -> str:
        """The uuid of the demonstration that the learner works on; empty: none."""
        demo = self._learning.awaited
        return demo.uuid if demo is not None else ''

    @property
    def criteria_met(self) -> bool:
        """Whether the learner says so, on the features that are chosen now."""
        option = self._option
        return option is not None and self._learning.criteria_met(
            self._notebook.participant, option
        )

    @property
    def view(self) -> LessonView:
        """Everything that a terminal shows."""
        shown = self._view
        return replace(shown, text=f'{self._notice} {hint(shown)}'.strip())

    # What the person asks for.

    def open_session(self, participant: str, session: str) -> Answer:
        """Begin a sitting, or go on with it where it was left; an empty code makes a new one."""
        return self._hindrance() or self._turned(self._notebook.open_session(participant, session))

    def define_option(self, name: str, ask_again: bool = False) -> Answer:
        """Name an option to teach, or take it up again."""
        return self._hindrance() or self._turned(self._notebook.define_option(name, ask_again))

    def answer_question(self, question_id: int, yes: bool) -> Answer:
        """Answer the open question."""
        if self._paused:
            return self._not_now()
        if self._occupied:
            return Answer(Status.NOT_ASKED, 'no question is open')
        answer = self._notebook.answer_question(question_id, yes)
        if answer.status in (Status.OK, Status.NO_FEATURE):
            self._notice = '' if answer.ok else answer.detail
            self._look_at_progress()
        return answer

    def prepare(self, start_state: str = '') -> Answer:
        """
        Choose the start state of the next demonstration.

        After OK the lesson waits for ``began`` or ``not_begun``.

        :param start_state: in the domain's notation; empty: drawn by the strategy.
        """
        if self._paused:
            return self._not_now()
        if self._option is None or self.phase is not Phase.READY or self._preparing:
            return self._not_ready()
        try:
            state = self._start_state(start_state, self._option)
        except DomainError as error:
            return Answer(Status.BAD_STATE, str(error))
        self._preparing, self._trace = True, Trace()
        seed = self._draws.episode_seed(self._notebook.participant, self._option)
        return Answer(Status.OK, 'the start state is chosen', state=state, seed=seed)

    def began(self, episode: int, state: str) -> Answer:
        """Take note that game has begun the episode that ``prepare`` was for."""
        self._preparing = False
        if self._paused:
            return self._not_now()
        self._notice = ''
        self._attempt = Attempt(episode, state, self._clock())
        for moment in list(self._trace.moments):  # states that came before game's answer
            self._watch(moment)
        return Answer(Status.OK, f'episode {episode} begins', state=state)

    def not_begun(self, status: Status, cause: str) -> Answer:
        """Take note that there is no episode, or that its first state did not come."""
        self._preparing = False
        self._give_up(cause)
        return Answer(status, cause)

    def end_demonstration(
        self, verdict: Verdict | None, episode: int, step: int, can_start_at_end: bool
    ) -> Answer:
        """
        Carry out the person's verdict on the demonstration under way.

        :param verdict: None: the request named none that exists.
        :param episode: of the last state that the person saw; ``step`` too.
        """
        attempt, option = self._attempt, self._option
        if attempt is None or option is None:
            return _wrong('no demonstration is under way; begin one first')
        objected = objection(self._trace, verdict, (episode, step), attempt)
        if objected is not None:
            return objected
        if verdict is Verdict.DISCARD:
            self._give_up('')
            return Answer(Status.OK, 'discarded; the same start state can be tried again')
        label = Label(
            self._notebook.participant,
            self._notebook.session,
            option.name,
            option.number,
            option.questions.chosen,
        )
        demonstration = build(
            self._domain,
            self._trace,
            label,
            seconds=round(self._clock() - attempt.began, 3),
            can_start_at_end=can_start_at_end and verdict is Verdict.DONE,
        )
        return self._keep_demonstration(demonstration)

    def withdraw(self, uuid: str = '') -> Answer:
        """
        Take back the newest demonstration of the option; its start state comes again.

        :param uuid: of the one that is meant, so that no other is taken back; empty: whichever
            is the newest.
        """
        working = self._learning.awaited is not None
        wait = _wrong('the learner still works on a demonstration; wait for it')
        answer = self._hindrance() or (wait if working else self._notebook.withdraw(uuid))
        if answer.demonstration is not None:
            self._again = self._notice = ''  # the option itself knows where to start again
            self._learning.awaited = answer.demonstration
        return answer

    # What the game and the learner tell.

    def saw(self, moment: Transition) -> bool:
        """
        Take in one state of the game's stream.

        :return: whether the view has changed.
        """
        self._trace.add(moment)
        return self._watch(moment)

    def reached(self, episode: int, step: int) -> bool:
        """Tell whether the stream has come so far, or waiting for it is of no use."""
        if self._attempt is None or self._attempt.episode != episode:
            return True
        return self._trace.episode == episode and self._trace.last >= step

    def learner_said(self, progress: Sequence[Progress]) -> None:
        """Take in what the learner knows of every option."""
        self._learning.heard(progress)
        self.starts_know_more()

    def starts_know_more(self) -> None:
        """Go on where both learner and start states have counted the newest demonstration."""
        option, awaited = self._option, self._learning.awaited
        if option is not None and awaited is not None:
            if not self._learning.has_counted(awaited) or not self._draws.know(option, awaited):
                return
            self._learning.awaited = None
        self._look_at_progress()

    def learner_refused(self, uuid: str, detail: str) -> None:
        """Take in that the learner did not take a demonstration; it stays in the store."""
        self._notice = self._learning.refused(uuid, detail) or self._notice
        self._look_at_progress()

    def learner_silent(self) -> None:
        """Go on without the learner, which has not answered in time."""
        self._notice = self._learning.silent() or self._notice
        self._look_at_progress()

    def pause(self, reason: str) -> None:
        """
        Let nothing new begin; a demonstration under way can still be ended, and is kept.

        :param reason: what is wrong and what to do; empty: go on.
        """
        self._paused = reason

    # How it is done.

    @property
    def _view(self) -> LessonView:
        """The view without its text."""
        base = LessonView(
            phase=self.phase,
            participant=self._notebook.participant,
            session=self._notebook.session,
            budget=self._rules.budget,
            strategy=self._rules.strategy,
            paused=self._paused,
        )
        option, attempt = self._option, self._attempt
        if option is None:
            return base
        feature = option.questions.open
        return replace(
            base,
            option_name=option.name,
            question_id=self._notebook.question_id,
            question=question_text(option.name, feature) if feature is not None else '',
            question_feature=feature.name if feature is not None else '',
            questions_total=len(self._domain.features),
            chosen_features=option.questions.chosen,
            earlier_features=option.questions.earlier if feature is not None else (),
            n_demonstrations=option.n_trajectories,
            n_not_here=option.n_not_here,
            last_uuid=option.newest.uuid if option.newest is not None else '',
            start_state=attempt.start_state if attempt is not None else '',
            episode=attempt.episode if attempt is not None else 0,
            criteria_met=self.criteria_met,
        )

    @property
    def _spent(self) -> bool:
        return self._option is not None and (
            len(self._option.demonstrations) >= self._rules.budget
        )

    @property
    def _occupied(self) -> bool:
        return self._attempt is not None or self._preparing

    def _hindrance(self) -> Answer | None:
        if self._paused:
            return self._not_now()
        return _wrong('end the demonstration under way first') if self._occupied else None

    def _not_now(self) -> Answer:
        return Answer(Status.PAUSED, f'the lesson is paused: {self._paused}')

    def _not_ready(self) -> Answer:
        if self._preparing or self._attempt is not None:
            return _wrong('a demonstration is under way; end it first')
        if self._spent and self.phase is Phase.FINISHED:
            return Answer(Status.BUDGET_SPENT, hint(self._view))
        return _wrong(hint(self._view))

    def _turned(self, answer: Answer) -> Answer:
        """Turn to the option that the notebook is open at now."""
        if answer.ok:
            if self._option is not self._notebook.option:
                self._learning.awaited, self._again = None, ''
            self._option = self._notebook.option
            self._notice = ''
            self._look_at_progress()
        return answer

    def _look_at_progress(self) -> None:
        option = self._option
        self._done = (
            option is not None
            and self.criteria_met
            and self._draws.exhausted(self._notebook.participant, option)
        )

    def _start_state(self, asked_for: str, option: OptionHistory) -> str:
        if asked_for:
            return self._draws.check(asked_for)
        again = self._again or option.next_start
        return again or self._draws.draw(self._notebook.participant, option)

    def _watch(self, moment: Transition) -> bool:
        if self._attempt is None:
            return False
        cause = self._attempt.spoilt(moment, self._trace)
        if cause:
            self._give_up(f'The demonstration is given up: {cause}.')
            return True
        if moment.episode == self._attempt.episode and (moment.terminated or moment.truncated):
            self._notice = (
                'The task is over.' if moment.terminated else 'The episode is at its step limit.'
            )
            return True
        return False

    def _give_up(self, notice: str) -> None:
        if self._attempt is not None:
            self._again = self._attempt.start_state
        self._attempt = None
        self._notice = notice

    def _keep_demonstration(self, demonstration: Demonstration) -> Answer:
        try:
            check_demonstration(demonstration, self._domain)
        except DemonstrationError as error:
            self._give_up(f'The demonstration was refused and discarded: {error}.')
            return Answer(Status.REFUSED, str(error))
        if (failed := self._notebook.keep(demonstration)) is not None:
            return failed
        self._attempt = None
        self._again = self._notice = ''
        self._learning.awaited = demonstration
        text = f'demonstration {demonstration.number} of {demonstration.option_name} is kept'
        if self._paused:
            self._notice = f'The demonstration is {_UNRECORDED}.'
            text = f'{text} {_UNRECORDED}'
        return Answer(Status.OK, text, demonstration=demonstration)


def _wrong(detail: str) -> Answer:
    return Answer(Status.WRONG_PHASE, detail)
