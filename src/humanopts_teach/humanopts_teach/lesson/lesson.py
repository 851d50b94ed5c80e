"""
The teaching session as a state machine (paper, sections 5 and 6).

Every method handles one request or event, and leaves the lesson in a valid phase. Answers and
demonstrations are on disk before a request is answered with OK; a request that cannot be saved
changes nothing.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from humanopts_env.domains.base import ActableDomain
from humanopts_env.domains.described import can_simulate
from humanopts_env.game import Source, Transition
from humanopts_learner.demonstrations import (
    check_method,
    Demonstration,
    DemonstrationError,
    Kind,
    option_name_fault,
    shown,
)
from humanopts_learner.options.checks import Check
from humanopts_learner.options.conflicts import contradiction
from humanopts_learner.summary import OptionSummary
from humanopts_ros.limits import composed
from humanopts_teach.lesson.advice import advice
from humanopts_teach.lesson.attempt import Attempt
from humanopts_teach.lesson.examination import Examination
from humanopts_teach.lesson.feedback import Feedback
from humanopts_teach.lesson.history import OptionHistory
from humanopts_teach.lesson.next_start import NextStart
from humanopts_teach.lesson.notebook import Notebook
from humanopts_teach.lesson.records import Records
from humanopts_teach.lesson.requests import (
    AddDemonstrations,
    Answer,
    AnswerQuestion,
    BeginDemonstration,
    ChangeOption,
    DefineOption,
    EndDemonstration,
    LessonRequest,
    LessonView,
    ListDemonstrations,
    OpenSession,
    Phase,
    RefusalError,
    RequestStatus,
    Verdict,
    WithdrawDemonstration,
)
from humanopts_teach.lesson.seeded_starts import SeededStarts
from humanopts_teach.lesson.store import DemonstrationStore, Entry

_ALL_NO = 'All answers were no, but an option depends on something: please answer again.'
_READY = Phase.READY, Phase.CHECKING, Phase.EXAM, Phase.FINISHED  # a demonstration can begin
_UNRECORDED = 'on disk but not in this recording; the next recording will contain it'
_OVER, _AT_LIMIT = 'The task is over.', 'The episode is at its step limit.'
_REFUSED = {
    False: 'The learner refused the demonstration: {detail}.',
    True: 'The learner did not withdraw the demonstration: {detail}.',
}
_SILENT = {
    False: 'The learner is not responding. The demonstration is on disk, and will be sent '
    'again when a learner starts.',
    True: 'The learner is not responding. The withdrawal is on disk, and will be sent again '
    'when a learner starts.',
}


class Lesson:
    """
    A lesson with one participant, one option and one demonstration at a time.

    :ivar feedback: results of learner and planner.
    """

    def __init__(
        self,
        domain: ActableDomain,
        store: DemonstrationStore,
        starts: SeededStarts,
        *,
        clock: Callable[[], float],
        today: Callable[[], str],
    ) -> None:
        """
        Start without a session.

        :param clock: monotonic clock, s.
        :param today: returns the date as YYYYMMDD, for session codes.
        """
        self._domain, self._starts = domain, starts
        self._clock, self._today = clock, today
        self._book = Notebook(domain, store)
        self._option: OptionHistory | None = None
        self.feedback = Feedback(domain, starts)
        self._examination = Examination(starts)
        self._attempt: Attempt | None = None  # set when the lesson requests an episode
        self._episode = 0  # of the newest demonstration begun
        self._next = NextStart(domain, starts, self.feedback)
        self._notice = ''
        self._paused = ''  # reason for the pause; empty: not paused

    # Properties and views.

    @property
    def phase(self) -> Phase:
        """The phase of the lesson."""
        option = self._option
        for phase, holds in (
            (Phase.NO_SESSION, not self._book.history.participant),
            (Phase.NO_OPTION, option is None),
            (Phase.DEMONSTRATING, self._under_way is not None),
            (Phase.ASKING, option is not None and option.open_feature is not None),
            (Phase.LEARNING, self.feedback.awaited is not None),
        ):
            if holds:
                return phase
        stage = self._examination.stage
        return Phase.FINISHED if stage is Phase.READY and self._spent else stage

    @property
    def awaited(self) -> str:
        """The uuid of the demonstration that the learner is processing; empty: none."""
        return self.feedback.awaited.uuid if self.feedback.awaited is not None else ''

    @property
    def view(self) -> LessonView:
        """The data shown by terminals."""
        facts = self._facts
        return replace(facts, text=' '.join(filter(None, (self._notice, self._advice(facts)))))

    @property
    def _facts(self) -> LessonView:
        """The view without its text."""
        phase, rules = self.phase, self._starts.rules
        view = LessonView(
            phase=phase,
            participant=self._book.history.participant,
            session=self._book.session,
            budget=rules.budget,
            strategy=rules.strategy,
            derived_features=self._book.history.derived,
            paused=self._paused,
            **self.feedback.shown(self._option),
        )
        option, attempt = self._option, self._under_way
        if option is None:
            return view
        if (check := self._check) is not None:
            view = replace(
                view,
                question_id=self._question_id,
                question=check.text,
                question_states=check.states,
                question_compared=check.compared,
            )
        if (feature := option.open_feature) is not None:
            # Wording of the paper (section 5).
            question = f"Does the '{option.name}' option depend on {feature.question}?"
            view = replace(
                view,
                question_id=self._question_id,
                question=question,
                question_feature=feature.name,
                earlier_features=option.earlier,
            )
        if attempt is not None:
            start, steps = attempt.start_state, attempt.machine_steps
            view = replace(view, start_state=start, machine_steps=steps, exam=attempt.exam)
        return replace(
            view,
            option_name=option.name,
            questions_total=len(self._book.history.features),
            chosen_features=option.chosen,
            method=self.feedback.method(option),
            n_demonstrations=option.n_trajectories,
            n_not_here=len(option.demonstrations) - option.n_trajectories,
            last_uuid=option.newest.uuid if option.newest is not None else '',
            episode=self._episode,
        )

    def demonstrations(self) -> list[Demonstration]:
        """
        Return the demonstrations of all participants in this domain, without duplicates.

        For a withdrawn demonstration, only the withdrawal is returned.

        :raises RefusalError: a participant's file cannot be read.
        """
        return self._book.demonstrations()

    # Requests of the person.

    def carry_out(self, request: LessonRequest) -> Answer:
        """
        Carry out a request.

        When ``BeginDemonstration`` is answered with OK, the start state is chosen, and the lesson
        waits for ``began`` or ``not_begun``.
        """
        carry_out: dict[type[LessonRequest], Callable[[Any], Answer]] = {
            OpenSession: self._open_session,
            DefineOption: self._define_option,
            AnswerQuestion: self._answer_question,
            BeginDemonstration: self._prepare,
            EndDemonstration: self._end_demonstration,
            AddDemonstrations: self._add,
            WithdrawDemonstration: self._withdraw,
            ListDemonstrations: self._list,
            ChangeOption: self._change_option,
        }
        during = isinstance(request, AnswerQuestion | EndDemonstration | ListDemonstrations)
        try:
            if self._paused and not isinstance(request, EndDemonstration | ListDemonstrations):
                raise RefusalError(RequestStatus.PAUSED, f'the lesson is paused: {self._paused}')
            if self._attempt is not None and not during:
                who = self._book.history.participant
                raise _wrong_phase(f'{who} has a demonstration under way; end it first')
            taken_back = isinstance(request, WithdrawDemonstration | ChangeOption)
            if self.feedback.awaited is not None and taken_back:
                raise _wrong_phase('the learner is still working on a demonstration; wait for it')
            return carry_out[type(request)](request)
        except RefusalError as refusal:
            return refusal.answer

    def draw_ahead(self) -> None:
        """Draw the sample for the next start state while the learner is busy."""
        if self.phase is Phase.LEARNING and self._option is not None:
            self._starts.draw_ahead(self._option, self._book.history.options)

    def began(self, episode: int, state: str) -> Answer:
        """Begin the prepared demonstration, after the game has begun its episode."""
        attempt = self._attempt
        assert attempt is not None, 'a demonstration was prepared'
        if self._paused:
            self._attempt = None
            return Answer(RequestStatus.PAUSED, f'the lesson is paused: {self._paused}')
        self._notice = ''
        attempt.episode, attempt.start_state, attempt.began = episode, state, self._clock()
        self._episode = episode
        for transition in list(attempt.transitions):  # arrived before the game's answer
            self._watch(transition)
        return _ok(f'episode {episode} begins', episode=episode, state=state)

    def not_begun(self, status: RequestStatus, cause: str) -> Answer:
        """Abandon the demonstration, because its episode or first state did not arrive."""
        self._abandon(cause)
        return Answer(status, cause)

    def pause(self, reason: str) -> None:
        """
        Pause the lesson; a demonstration in progress can still be ended and kept.

        :param reason: description of the fault and its remedy; empty: resume.
        """
        self._paused = reason

    # Events from the game and the learner.

    def add_transition(self, transition: Transition) -> bool:
        """
        Add a state from the game's stream.

        :return: whether the view has changed.
        """
        if self._attempt is None:
            self._next.drive_past(transition)
            return False
        self._attempt.add(transition)
        return self._watch(transition)

    def game_restarted(self) -> bool:
        """
        Abandon the current demonstration, because its episode ended with the game.

        :return: whether the view has changed.
        """
        changed, self._episode = self._episode != 0, 0  # a new game numbers its episodes from 1
        if self._under_way is not None:
            self._abandon('The demonstration was abandoned: the game was restarted.')
        return changed

    def resume(self, participant: str, session: str) -> Answer:
        """
        Resume a session left open by an earlier process.

        Wait for the learner, since it may not have received the newest demonstration.
        """
        answer = self.carry_out(OpenSession(participant, session))
        if answer.ok:
            self._notice = 'The lesson was restarted; a demonstration under way was abandoned.'
            option = self._option
            newest = (option.newest, *option.verdicts)[-1] if option is not None else None
            self.feedback.awaited = newest
        return answer

    def reached(self, episode: int, step: int) -> bool:
        """Return whether a state has arrived or can no longer arrive."""
        if self._attempt is None or self._attempt.episode != episode:
            return True
        newest_episode, newest_step = self._attempt.here
        return newest_episode == episode and newest_step >= step

    def update_summaries(self, summaries: Sequence[OptionSummary]) -> None:
        """Store the learner's summaries of all options."""
        self.feedback.update_summaries(summaries)
        self._check_processed()

    def update_option(self, participant: str, option_name: str, text: str) -> None:
        """
        Store an option published by the learner.

        :raises OptionError: the text is not a valid option, or belongs to another domain.
        """
        if self.feedback.update_option(participant, option_name, text):
            self._check_processed()

    def learner_refused(self, uuid: str, detail: str) -> None:
        """Stop waiting for a demonstration that the learner refused; it stays in the store."""
        if uuid == self.awaited:
            self._stop_waiting(_REFUSED, detail)

    def learner_silent(self) -> None:
        """Stop waiting for the learner after a timeout."""
        self._stop_waiting(_SILENT)

    def _stop_waiting(self, notices: dict[bool, str], detail: str = '') -> None:
        if self.feedback.awaited is not None:
            self._notice = notices[self.feedback.awaited.withdrawn].format(detail=detail)
            self.feedback.awaited = None
            self._check_done()

    # State of the lesson.

    @property
    def _under_way(self) -> Attempt | None:
        """The current demonstration; None: no episode has begun."""
        return self._attempt if self._attempt is not None and self._attempt.episode else None

    @property
    def _spent(self) -> bool:
        option, budget = self._option, self._starts.rules.budget
        return option is not None and len(option.demonstrations) >= budget

    @property
    def _check(self) -> Check | None:
        """The open question about a run; None: none is open."""
        return self._examination.check if self.phase is Phase.CHECKING else None

    @property
    def _question_id(self) -> int:
        """The id of the open question, unique across options; 0: none is open."""
        return (
            self._book.history.n_answers + 1 if self.phase in (Phase.ASKING, Phase.CHECKING) else 0
        )

    def _check_processed(self) -> None:
        """Stop waiting once summary and start states include the awaited demonstration."""
        if self._option is None or self.feedback.has_processed(self._option):
            self.feedback.awaited = None
            self._check_done()

    def _check_done(self) -> None:
        """Choose the next stage: a demonstration, a question about a run, the exam or nothing."""
        settled = self.feedback.settled(self._option)
        self._examination.update(self._option, settled, self._book.history.options)
        self._next.look(self._option)

    def _advice(self, facts: LessonView) -> str:
        settled, option = self.feedback.settled(self._option), self._option
        wrong = option.wrong_run if option is not None else None
        missing = None if can_simulate(self._domain) else self._next.missing
        return advice(facts, settled, wrong, self._examination.stage, missing)

    # Handlers of requests; they raise RefusalError to refuse a request.

    def _write(self, *entries: Entry) -> None:
        self._book.write(*entries)
        self.feedback.sort_stuck()

    def _open_session(self, request: OpenSession) -> Answer:
        """Open a session, or resume it."""
        self._book.open(request.participant, request.session, self._today)
        history, session = self._book.history, self._book.session
        self.feedback.begin(history)
        self._switch_to(history.options.get(history.sessions[session]))
        return _ok(
            f'session {session} of {history.participant} is open',
            session=session,
            known_options=tuple(history.options),
        )

    def _define_option(self, request: DefineOption) -> Answer:
        """Name a new option to teach, or resume an existing one."""
        if not self._book.history.participant:
            raise _wrong_phase('open a session first')
        name = composed(request.name.strip())
        if fault := option_name_fault(name):
            raise RefusalError(RequestStatus.BAD_NAME, fault)
        known = self._book.history.options.get(name)
        method = request.method or (known.method if known is not None else '')
        try:
            check_method(method or self._starts.rules.method, self._domain)
        except DemonstrationError as error:
            raise RefusalError(RequestStatus.BAD_METHOD, str(error)) from error
        derived = self._book.new_features((*self._starts.rules.derive, *request.derived_features))
        again = request.ask_again
        self._write(
            *(self._book.event('feature', '', feature=feature) for feature in derived),
            self._book.event('option', name, ask_again=again, method=request.method),
        )
        self._switch_to(self._book.history.options[name])
        text = f'{"new option" if known is None else "continuing"}: {name}'
        if derived:
            text += f'; also asked about: {", ".join(derived)}'
        return _ok(text, resumed=known is not None)

    def _switch_to(self, option: OptionHistory | None) -> None:
        if option is not self._option:
            self.feedback.awaited = None
            self._next.forget()
        self._option, self._notice = option, ''
        self._check_done()

    def _answer_question(self, request: AnswerQuestion) -> Answer:
        """Answer the open question, about a feature or a run, or reopen the previous one."""
        option = self._option
        if option is None or self._attempt is not None:
            raise _not_asked('no question is open')
        if request.back:
            return self._take_back(request, option)
        feature, check = option.open_feature, self._check
        if feature is None and check is None:
            raise _not_asked('no question is open')
        if request.question_id != self._question_id:
            raise _not_asked(
                f'question {request.question_id} is not open; question {self._question_id} '
                f'is, about {"a run" if feature is None else feature.name}'
            )
        if check is not None:
            run = self._records(option).answered(check, yes=request.yes)
            return self._keep(run, 'the run is right' if request.yes else 'the run is wrong')
        assert feature is not None
        yes = request.yes
        self._write(self._book.event('answer', option.name, feature=feature.name, yes=yes))
        answer = _ok(f'{feature.name}: {"yes" if yes else "no"}')
        if not option.answers:
            answer = Answer(RequestStatus.NO_FEATURE, _ALL_NO)
        self._notice = '' if answer.ok else answer.detail
        self._check_done()
        return answer

    def _take_back(self, request: AnswerQuestion, option: OptionHistory) -> Answer:
        """Withdraw the last verdict on a run of the option, or the last answer about a feature."""
        verdicts = option.verdicts if option.open_feature is None else []
        if verdicts and self.feedback.awaited is not None:
            raise _not_asked('the learner is still working on the last answer; wait for it')
        if request.question_id != self._question_id or not (option.answers or verdicts):
            raise _not_asked('there is no previous question to go back to')
        if verdicts:
            return self._withdraw(WithdrawDemonstration(verdicts[-1].uuid))
        self._write(self._book.event('answer taken back', option.name))
        self._notice = ''
        self._check_done()
        return _ok('the previous question is open again')

    def _prepare(self, request: BeginDemonstration) -> Answer:
        option, phase = self._option, self.phase
        spent = self._spent and not request.exam
        if option is None or phase not in ((Phase.EXAM,) if request.exam else _READY) or spent:
            spent = spent and phase in _READY
            status = RequestStatus.BUDGET_SPENT if spent else RequestStatus.WRONG_PHASE
            raise RefusalError(status, self._advice(self._facts))
        state, seed = self._next.choose(option, self._book.history.options, request)
        self._attempt = Attempt(state, request.watch or request.exam, request.exam)
        return _ok('the start state has been chosen', state=state, seed=seed)

    def _watch(self, transition: Transition) -> bool:
        """Handle a state from the stream; return whether the view has changed."""
        attempt = self._under_way
        if attempt is None:
            return False
        if cause := attempt.invalidated_by(transition):
            self._abandon(f'The demonstration was abandoned: {cause}.')
            return True
        over = transition.terminated or transition.truncated
        if over and transition.episode == attempt.episode:
            self._notice = _OVER if transition.terminated else _AT_LIMIT
            return True
        return transition.action_source is Source.MACHINE

    def _abandon(self, notice: str) -> None:
        if self._under_way is not None and not self._under_way.watch:
            self._next.repeat(self._under_way.start_state)
        self._attempt, self._notice = None, notice

    def _end_demonstration(self, request: EndDemonstration) -> Answer:
        attempt, option = self._under_way, self._option
        if attempt is None or option is None:
            raise _wrong_phase('no demonstration is under way; begin one first')
        attempt.check(request)
        if request.verdict is Verdict.DISCARD:
            self._abandon('')
            return _ok('discarded; the same start state can be tried again')
        try:
            demo = self._records(option).ended(attempt, request, self._clock() - attempt.began)
        except DemonstrationError as error:
            self._abandon(f'The demonstration was refused and discarded: {error}.')
            raise RefusalError(RequestStatus.REFUSED, str(error)) from error
        if attempt.exam:
            number, verdict = option.exam_runs + 1, 'right' if demo.right else 'wrong'
            return self._keep(demo, f'run {number} of the exam is {verdict}')
        found = contradiction(demo, option.demonstrations, self._domain)
        answer = self._keep(demo, f'demonstration {demo.number} of {demo.option_name} is kept')
        if found is None:
            return answer
        return replace(
            answer,
            contradiction=found.text,
            contradicts=found.earlier.uuid,
            situation=demo.states[found.step],
        )

    def _records(self, option: OptionHistory) -> Records:
        return Records(self._domain, option, self._book.session, self.feedback.method(option))

    def _keep(self, demo: Demonstration, text: str) -> Answer:
        """Keep a demonstration or a judged run, and wait for the learner."""
        self._write(demo)
        self._attempt, self._notice = None, ''
        self._next.forget()
        self.feedback.awaited = demo
        if self._paused:
            self._notice = f'The demonstration is {_UNRECORDED}.'
            text = f'{text} {_UNRECORDED}'
        return _ok(text, uuid=demo.uuid, unsent=(demo,))

    def _add(self, request: AddDemonstrations) -> Answer:
        """Add demonstrations recorded elsewhere, either all or none."""
        option, phase = self._option, self.phase
        if option is None or phase not in (*_READY, Phase.LEARNING):
            raise _wrong_phase(self._advice(self._facts))
        left = self._starts.rules.budget - len(option.demonstrations)
        if len(request.demonstrations) > left:
            detail = f'{len(request.demonstrations)} are more than the budget has left: {left}'
            raise RefusalError(RequestStatus.BUDGET_SPENT, detail)
        try:
            added = self._records(option).added(request.demonstrations)
        except DemonstrationError as error:
            raise RefusalError(RequestStatus.REFUSED, str(error)) from error
        if added:
            self._write(*added)
            self.feedback.awaited, self._notice = added[-1], ''
        return _ok(f'demonstrations of {option.name} added: {len(added)}', unsent=added)

    def _withdraw(self, request: WithdrawDemonstration) -> Answer:
        """Withdraw a demonstration of the option."""
        if self._option is None:
            raise _wrong_phase('name the option first')
        name, newest = self._option.name, self._option.newest
        if newest is None:
            detail = f'{name} has no demonstration to withdraw'
            raise RefusalError(RequestStatus.NO_DEMONSTRATION, detail)
        wanted = request.uuid or newest.uuid
        demo = next((demo for demo in self._option.everything if demo.uuid == wanted), None)
        if demo is None:
            detail = f'{name} has no demonstration {wanted}, or it has already been withdrawn'
            raise RefusalError(RequestStatus.NO_DEMONSTRATION, detail)
        withdrawn = replace(demo, withdrawn=True)
        self._write(withdrawn)
        self.feedback.awaited = withdrawn
        self._notice = ''
        self._next.forget()  # the option's history keeps the start state
        count = len(demo.actions)
        steps = '1 step' if count == 1 else f'{count} steps'
        what = f'the demonstration of {steps}' if count else '"not here"'
        text = f'{what} has been withdrawn; its start will come up again'
        if demo.kind is Kind.JUDGED:
            text = f'the verdict "{"right" if demo.right else "wrong"}" is taken back'
        return _ok(text, uuid=wanted, unsent=(withdrawn,))

    def _list(self, request: ListDemonstrations) -> Answer:
        """List the demonstrations and judged runs of an option, including withdrawn ones."""
        option = self._book.option(request.option_name) if request.option_name else self._option
        if option is None:
            raise RefusalError(RequestStatus.NO_OPTION, 'no option is being taught: name one')
        everything = self._book.demonstrations(self._book.history.participant)
        found = tuple(demo for demo in everything if demo.option_name == option.name)
        return _ok(f'{len(found)} of {option.name}', demonstrations=found)

    def _change_option(self, request: ChangeOption) -> Answer:
        """Delete an option, or rename it by copying answers and demonstrations to a new one."""
        option, new = self._book.option(request.name), composed(request.new_name.strip())
        begun: list[Entry] = []
        moved: list[Demonstration] = []
        if request.new_name:
            if fault := option_name_fault(new):
                raise RefusalError(RequestStatus.BAD_NAME, fault)
            if new in self._book.history.options:
                detail = f'an option is already called {new!r}'
                raise RefusalError(RequestStatus.NAME_TAKEN, detail)
            begun.append(self._book.event('option', new, method=option.method))
            begun += [
                self._book.event('answer', new, feature=feature, yes=yes)
                for feature, yes in option.answers.items()
            ]
            moved = [*self._records(option).renamed(new, self._book.history.number(new))]
        withdrawn = [replace(demo, withdrawn=True) for demo in option.everything]
        deleted = self._book.event('option deleted', option.name)
        self._write(*begun, *moved, *withdrawn, deleted)
        if new or option is self._option:
            self._switch_to(self._book.history.options.get(new))
        if shown(moved):
            self.feedback.awaited = shown(moved)[-1]
        return _ok(
            f'{option.name} is now called {new}' if new else f'{option.name} is deleted',
            known_options=tuple(self._book.history.options),
            unsent=(*moved, *withdrawn),
        )


def _ok(detail: str, **found: Any) -> Answer:
    return Answer(RequestStatus.OK, detail, **found)


def _not_asked(detail: str) -> RefusalError:
    return RefusalError(RequestStatus.NOT_ASKED, detail)


def _wrong_phase(detail: str) -> RefusalError:
    return RefusalError(RequestStatus.WRONG_PHASE, detail)
