"""
The teaching session as a state machine (paper, sections 5 and 6).

Every method takes one request or one piece of news, and leaves the lesson in a phase from which it
can go on. What the person said is in the store before a request is answered OK.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from humanopts_env.domains.base import Domain, DomainError
from humanopts_env.game import Transition
from humanopts_learner.demonstrations import (
    check_demonstration,
    Demonstration,
    DemonstrationError,
)
from humanopts_teach.lesson.attempt import Attempt, build_demonstration, Label, Trajectory
from humanopts_teach.lesson.requests import (
    Answer,
    AnswerQuestion,
    BeginDemonstration,
    DefineOption,
    EndDemonstration,
    LessonRequest,
    LessonView,
    OpenSession,
    OptionStatus,
    Phase,
    RequestStatus,
    Verdict,
    WithdrawDemonstration,
)
from humanopts_teach.lesson.session_log import OptionHistory, SessionLog
from humanopts_teach.lesson.start_states import LessonRules, StartStates
from humanopts_teach.lesson.store import DemonstrationStore

_UNRECORDED = 'on disk, but not in this recording: the next one has it'
_OVER, _AT_LIMIT = 'The task is over.', 'The episode is at its step limit.'
_REFUSED = {
    False: 'The learner refused the demonstration: {detail}.',
    True: 'The learner did not take the demonstration back: {detail}.',
}
_SILENT = {
    False: 'The learner does not answer. The demonstration is on disk, and is sent again to the '
    'next learner that starts.',
    True: 'The learner does not answer. That the demonstration is taken back is on disk, and is '
    'sent again to the next learner that starts.',
}
_HINTS = {
    Phase.NO_SESSION: 'Open a session to begin.',
    Phase.NO_OPTION: 'Name the option that you want to teach.',
    Phase.ASKING: 'Answer the question.',
    Phase.READY: 'Begin the next demonstration.',
    Phase.DEMONSTRATING: 'Show the option, then say done; or say not here, or discard.',
    Phase.LEARNING: 'The learner works on the demonstration.',
    Phase.FINISHED: 'Name the next option to teach.',
}
_GOES_ON = (Phase.DEMONSTRATING, Phase.LEARNING)  # also while the lesson is paused


class LearnerProgress:
    """What the lesson knows of the learner: how far each option is, and what it works on."""

    def __init__(self) -> None:
        self._options: dict[tuple[str, str], OptionStatus] = {}
        self.awaited: Demonstration | None = None  # kept or taken back; not counted in or out yet

    def update(self, options: Sequence[OptionStatus]) -> None:
        """Keep what the learner knows of every option."""
        self._options = {(status.participant, status.option_name): status for status in options}

    def criteria_met(self, participant: str, option: OptionHistory) -> bool:
        """Tell whether the learner says so, on the features that are chosen now."""
        known = self._options.get((participant, option.name))
        chosen = set(option.questions.chosen)
        return (
            known is not None
            and known.criteria_met
            and known.last_uuid not in option.withdrawn  # the learner still counts that one
            and set(known.features) == chosen
        )

    def has_counted(self, demo: Demonstration) -> bool:
        """Tell whether the newest demonstration is counted in; out, where it is withdrawn."""
        known = self._options.get((demo.participant, demo.option_name))
        newest = known is not None and known.last_uuid == demo.uuid
        return newest != demo.withdrawn

    def refused(self, uuid: str, detail: str) -> str:
        """
        Go on without a demonstration that the learner did not take.

        :return: what to tell the person; empty: it was not the awaited one.
        """
        demo = self.awaited
        if demo is None or demo.uuid != uuid:
            return ''
        self.awaited = None
        return _REFUSED[demo.withdrawn].format(detail=detail)

    def silent(self) -> str:
        """
        Go on without the learner, which has not answered in time.

        :return: what to tell the person; empty: nothing was awaited.
        """
        demo, self.awaited = self.awaited, None
        return _SILENT[demo.withdrawn] if demo is not None else ''


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
        self._starts = starts
        self._rules = rules
        self._clock = clock
        self._log = SessionLog(domain, store, today)
        self._option: OptionHistory | None = None
        self._trajectory = Trajectory()
        self._attempt: Attempt | None = None
        self._again = ''  # start state of a demonstration that came to nothing
        self._preparing = False  # game was asked for an episode and has not answered
        self._learner = LearnerProgress()
        self._done = False  # criteria met, and the strategy has nothing left to ask
        self._notice = ''
        self._paused = ''  # why nothing new can be begun; empty: it can

    # What can be read.

    @property
    def phase(self) -> Phase:
        """Where the lesson stands."""
        if not self._log.participant:
            return Phase.NO_SESSION
        if self._option is None:
            return Phase.NO_OPTION
        if self._attempt is not None:
            return Phase.DEMONSTRATING
        if self._option.questions.open is not None:
            return Phase.ASKING
        if self._learner.awaited is not None:
            return Phase.LEARNING
        return Phase.FINISHED if self._done or self._spent else Phase.READY

    def demonstrations(self) -> list[Demonstration]:
        """
        Return all that anybody has shown in this domain, in the order of the store.

        Of one that was taken back, only the withdrawal is returned.
        """
        return self._log.demonstrations()

    @property
    def awaited(self) -> str:
        """The uuid of the demonstration that the learner works on; empty: none."""
        demo = self._learner.awaited
        return demo.uuid if demo is not None else ''

    @property
    def criteria_met(self) -> bool:
        """Whether the learner says so, on the features that are chosen now."""
        option = self._option
        return option is not None and self._learner.criteria_met(self._log.participant, option)

    @property
    def view(self) -> LessonView:
        """Everything that a terminal shows."""
        view = self._view
        return replace(view, text=f'{self._notice} {hint(view)}'.strip())

    # What the person asks for.

    def carry_out(self, request: LessonRequest) -> Answer:
        """
        Carry out one request.

        After OK to ``BeginDemonstration``, the start state is chosen, and the lesson waits for
        ``began`` or ``not_begun``.
        """
        match request:
            case OpenSession():
                return self._hindrance() or self._turned(self._log.open_session(request))
            case DefineOption():
                return self._hindrance() or self._turned(self._log.define_option(request))
            case AnswerQuestion():
                return self._answer_question(request)
            case BeginDemonstration():
                return self._prepare(request)
            case EndDemonstration():
                return self._end_demonstration(request)
            case WithdrawDemonstration():
                return self._withdraw(request)

    def began(self, episode: int, state: str) -> Answer:
        """Note that game has begun the episode of a demonstration that was prepared."""
        self._preparing = False
        if self._paused:
            return self._not_now()
        self._notice = ''
        self._attempt = Attempt(episode, state, self._clock())
        for transition in list(self._trajectory.transitions):  # came before game's answer
            self._watch(transition)
        detail = f'episode {episode} begins'
        return Answer(RequestStatus.OK, detail, episode=episode, state=state)

    def not_begun(self, status: RequestStatus, cause: str) -> Answer:
        """Note that there is no episode, or that its first state did not come."""
        self._preparing = False
        self._give_up(cause)
        return Answer(status, cause)

    # What the game and the learner tell.

    def saw(self, transition: Transition) -> bool:
        """
        Add one state of the game's stream.

        :return: whether the view has changed.
        """
        self._trajectory.add(transition)
        return self._watch(transition)

    def reached(self, episode: int, step: int) -> bool:
        """Tell whether the stream has come so far, or waiting for it is of no use."""
        if self._attempt is None or self._attempt.episode != episode:
            return True
        return self._trajectory.episode == episode and self._trajectory.last_step >= step

    def learner_said(self, options: Sequence[OptionStatus]) -> None:
        """Keep what the learner knows of every option."""
        self._learner.update(options)
        self.starts_learned()

    def starts_learned(self) -> None:
        """Go on where both learner and start states have counted the newest demonstration."""
        option, awaited = self._option, self._learner.awaited
        if option is not None and awaited is not None:
            counted = self._learner.has_counted(awaited) and self._starts.counts(option, awaited)
            if not counted:
                return
            self._learner.awaited = None
        self._check_done()

    def learner_refused(self, uuid: str, detail: str) -> None:
        """Note that the learner did not take a demonstration; it stays in the store."""
        self._notice = self._learner.refused(uuid, detail) or self._notice
        self._check_done()

    def learner_silent(self) -> None:
        """Go on without the learner, which has not answered in time."""
        self._notice = self._learner.silent() or self._notice
        self._check_done()

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
            participant=self._log.participant,
            session=self._log.session,
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
            question_id=self._log.question_id,
            question=option.questions.text,
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
        return _wrong_phase('end the demonstration under way first') if self._occupied else None

    def _not_now(self) -> Answer:
        return Answer(RequestStatus.PAUSED, f'the lesson is paused: {self._paused}')

    def _not_ready(self) -> Answer:
        if self._occupied:
            return _wrong_phase('a demonstration is under way; end it first')
        if self._spent and self.phase is Phase.FINISHED:
            return Answer(RequestStatus.BUDGET_SPENT, hint(self._view))
        return _wrong_phase(hint(self._view))

    def _turned(self, answer: Answer) -> Answer:
        """Turn to the option that is open in the log now."""
        if answer.ok:
            if self._option is not self._log.option:
                self._learner.awaited, self._again = None, ''
            self._option = self._log.option
            self._notice = ''
            self._check_done()
        return answer

    def _check_done(self) -> None:
        option = self._option
        self._done = (
            option is not None
            and self.criteria_met
            and self._starts.exhausted(self._log.participant, option)
        )

    def _answer_question(self, request: AnswerQuestion) -> Answer:
        if self._paused:
            return self._not_now()
        if self._occupied:
            return Answer(RequestStatus.NOT_ASKED, 'no question is open')
        answer = self._log.answer_question(request)
        if answer.status in (RequestStatus.OK, RequestStatus.NO_FEATURE):
            self._notice = '' if answer.ok else answer.detail
            self._check_done()
        return answer

    def _prepare(self, request: BeginDemonstration) -> Answer:
        if self._paused:
            return self._not_now()
        if self._option is None or self.phase is not Phase.READY or self._preparing:
            return self._not_ready()
        try:
            state = self._start_state(request.start_state, self._option)
        except DomainError as error:
            return Answer(RequestStatus.BAD_STATE, str(error))
        self._preparing, self._trajectory = True, Trajectory()
        seed = self._starts.episode_seed(self._log.participant, self._option)
        return Answer(RequestStatus.OK, 'the start state is chosen', state=state, seed=seed)

    def _start_state(self, asked_for: str, option: OptionHistory) -> str:
        if asked_for:
            return self._starts.check(asked_for)
        again = self._again or option.next_start
        return again or self._starts.draw(self._log.participant, option)

    def _watch(self, transition: Transition) -> bool:
        if self._attempt is None:
            return False
        cause = self._attempt.spoilt(transition, self._trajectory)
        if cause:
            self._give_up(f'The demonstration is given up: {cause}.')
            return True
        over = transition.terminated or transition.truncated
        if over and transition.episode == self._attempt.episode:
            self._notice = _OVER if transition.terminated else _AT_LIMIT
            return True
        return False

    def _give_up(self, notice: str) -> None:
        if self._attempt is not None:
            self._again = self._attempt.start_state
        self._attempt = None
        self._notice = notice

    def _end_demonstration(self, request: EndDemonstration) -> Answer:
        attempt, option = self._attempt, self._option
        if attempt is None or option is None:
            return _wrong_phase('no demonstration is under way; begin one first')
        if (refusal := attempt.refusal(request, self._trajectory)) is not None:
            return refusal
        if request.verdict is Verdict.DISCARD:
            self._give_up('')
            detail = 'discarded; the same start state can be tried again'
            return Answer(RequestStatus.OK, detail)
        label = Label(
            self._log.participant,
            self._log.session,
            option.name,
            option.number,
            option.questions.chosen,
        )
        demonstration = build_demonstration(
            self._domain,
            self._trajectory,
            label,
            seconds=round(self._clock() - attempt.began, 3),
            can_start_at_end=request.can_start_at_end and request.verdict is Verdict.DONE,
        )
        return self._keep_demonstration(demonstration)

    def _keep_demonstration(self, demonstration: Demonstration) -> Answer:
        try:
            check_demonstration(demonstration, self._domain)
        except DemonstrationError as error:
            self._give_up(f'The demonstration was refused and discarded: {error}.')
            return Answer(RequestStatus.REFUSED, str(error))
        if (failed := self._log.keep(demonstration)) is not None:
            return failed
        self._attempt = None
        self._again = self._notice = ''
        self._learner.awaited = demonstration
        text = f'demonstration {demonstration.number} of {demonstration.option_name} is kept'
        if self._paused:
            self._notice = f'The demonstration is {_UNRECORDED}.'
            text = f'{text} {_UNRECORDED}'
        uuid = demonstration.uuid
        return Answer(RequestStatus.OK, text, uuid=uuid, demonstration=demonstration)

    def _withdraw(self, request: WithdrawDemonstration) -> Answer:
        if (hindrance := self._hindrance()) is not None:
            return hindrance
        if self._learner.awaited is not None:
            return _wrong_phase('the learner still works on a demonstration; wait for it')
        answer = self._log.withdraw(request)
        if answer.ok:
            self._again = self._notice = ''  # the option's history has the start state
            self._learner.awaited = answer.demonstration
        return answer


def _wrong_phase(detail: str) -> Answer:
    return Answer(RequestStatus.WRONG_PHASE, detail)


def hint(view: LessonView) -> str:
    """Return what to do next, in words; where an option is finished, why."""
    still = view.paused and view.phase not in _GOES_ON
    words = 'The lesson is paused.' if still else _HINTS[view.phase]
    if view.phase is not Phase.FINISHED:
        return words
    given = view.n_demonstrations + view.n_not_here
    spent = f'The budget of {view.budget} is spent. ' if given >= view.budget else ''
    reached = 'All criteria hold.' if view.criteria_met else 'Not all criteria hold.'
    return f'{spent}{reached} {words}'
