"""
The teaching session as a state machine (paper, sections 5 and 6).

Every method takes one request or one piece of news, and leaves the lesson in a phase from which it
can go on. What a person answers and shows is in the store before a request is answered OK; a
request that cannot be written changes nothing.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import count
from typing import Any

from humanopts_env.domains.base import ActableDomain, DomainError
from humanopts_env.domains.described import can_simulate
from humanopts_env.game import Source, Transition
from humanopts_learner.demonstrations import (
    check_demonstration,
    check_method,
    Demonstration,
    DemonstrationError,
    each_once,
    option_name_fault,
)
from humanopts_learner.options.conflicts import contradiction
from humanopts_learner.summary import OptionSummary
from humanopts_ros.limits import composed
from humanopts_teach.lesson.attempt import Attempt, with_uuid
from humanopts_teach.lesson.history import History, OptionHistory
from humanopts_teach.lesson.learning import Learning
from humanopts_teach.lesson.requests import (
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
from humanopts_teach.lesson.store import (
    AnswerTakenBack,
    CODE,
    CODE_RULE,
    DemonstrationStore,
    Entry,
    FeatureAnswered,
    OptionDefined,
    OptionDeleted,
    SessionOpened,
    similar_code,
    StoreError,
)

_ALL_NO = 'All answers were no, but an option depends on something: please answer again.'
_UNRECORDED = 'on disk but not in this recording; the next recording will have it'
_OVER, _AT_LIMIT = 'The task is over.', 'The episode is at its step limit.'
_REFUSED = {
    False: 'The learner refused the demonstration: {detail}.',
    True: 'The learner did not withdraw the demonstration: {detail}.',
}
_SILENT = {
    False: 'The learner does not answer. The demonstration is on disk, and is sent again when a '
    'learner starts.',
    True: 'The learner does not answer. The withdrawal is on disk, and is sent again when a '
    'learner starts.',
}
_HINTS = {
    Phase.NO_SESSION: 'Open a session to begin.',
    Phase.NO_OPTION: 'Name the option that you want to teach.',
    Phase.ASKING: 'Answer the question.',
    Phase.READY: 'Begin the next demonstration.',
    Phase.DEMONSTRATING: 'Show the option, then say done; or say not here, or discard.',
    Phase.LEARNING: 'The learner is working on the demonstration.',
    Phase.FINISHED: 'Name the next option to teach.',
}


class Lesson:
    """One participant at a time, one option at a time, one demonstration at a time."""

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
        Begin without a session.

        :param clock: seconds, never going back.
        :param today: the date as YYYYMMDD, for session codes.
        """
        self._domain = domain
        self._store = store
        self._starts = starts
        self._clock = clock
        self._today = today
        self._session = ''
        self._history = History(domain, '')
        self._option: OptionHistory | None = None
        self._learning = Learning(starts)
        self._attempt: Attempt | None = None  # from the request for an episode on
        self._episode = 0  # of the newest demonstration that was begun
        self._again = ''  # start state of a demonstration that was discarded or abandoned
        self._notice = ''
        self._paused = ''  # why nothing new can be begun; empty: it can

    # What can be read.

    @property
    def phase(self) -> Phase:
        """What the lesson waits for."""
        if not self._history.participant:
            return Phase.NO_SESSION
        if self._option is None:
            return Phase.NO_OPTION
        if self._under_way is not None:
            return Phase.DEMONSTRATING
        if self._option.questions.open is not None:
            return Phase.ASKING
        if self._learning.awaited is not None:
            return Phase.LEARNING
        return Phase.FINISHED if self._learning.done or self._spent else Phase.READY

    @property
    def _under_way(self) -> Attempt | None:
        """The demonstration under way; None: no episode of one has begun."""
        return self._attempt if self._attempt is not None and self._attempt.episode else None

    @property
    def awaited(self) -> str:
        """The uuid of the demonstration that the learner works on; empty: none."""
        return self._learning.awaited.uuid if self._learning.awaited is not None else ''

    @property
    def criteria_met(self) -> bool:
        """Whether the learner reports so, for the features and the method in force."""
        summary = self._learning.settled(self._option)
        return summary is not None and summary.criteria_met

    @property
    def view(self) -> LessonView:
        """Everything that a terminal shows."""
        phase, rules = self.phase, self._starts.rules
        view = LessonView(
            phase=phase,
            participant=self._history.participant,
            session=self._session,
            budget=rules.budget,
            strategy=rules.strategy,
            paused=self._paused,
            text=' '.join(filter(None, (self._notice, self._advice(phase)))),
        )
        option, attempt = self._option, self._under_way
        if option is None:
            return view
        questions = option.questions
        return replace(
            view,
            option_name=option.name,
            question_id=self._question_id,
            question=questions.text,
            question_feature=questions.open.name if questions.open is not None else '',
            questions_total=len(self._domain.features),
            chosen_features=questions.chosen,
            earlier_features=questions.earlier if questions.open is not None else (),
            method=self._learning.method(option),
            n_demonstrations=option.n_trajectories,
            n_not_here=len(option.demonstrations) - option.n_trajectories,
            last_uuid=option.newest.uuid if option.newest is not None else '',
            start_state=attempt.start_state if attempt is not None else '',
            episode=self._episode,
            machine_steps=attempt.machine_steps if attempt is not None else 0,
            criteria_met=self.criteria_met,
        )

    def demonstrations(self) -> list[Demonstration]:
        """
        Return the demonstrations of all participants in this domain, each once.

        Of one that was withdrawn, only the withdrawal is returned.

        :raises RefusalError: a file of theirs cannot be read.
        """
        return self._demonstrations(*self._store.participants())

    # What the person asks for.

    def carry_out(self, request: LessonRequest) -> Answer:
        """
        Carry out one request.

        After OK to ``BeginDemonstration``, the start state is chosen, and the lesson waits for
        ``began`` or ``not_begun``.
        """
        carry_out: dict[type[LessonRequest], Callable[[Any], Answer]] = {
            OpenSession: self._open_session,
            DefineOption: self._define_option,
            AnswerQuestion: self._answer_question,
            BeginDemonstration: self._prepare,
            EndDemonstration: self._end_demonstration,
            WithdrawDemonstration: self._withdraw,
            ListDemonstrations: self._list,
            ChangeOption: self._change_option,
        }
        try:
            if self._paused and not isinstance(request, EndDemonstration | ListDemonstrations):
                raise RefusalError(RequestStatus.PAUSED, f'the lesson is paused: {self._paused}')
            return carry_out[type(request)](request)
        except RefusalError as refusal:
            return refusal.answer

    def draw_ahead(self) -> None:
        """Draw what the next start state is chosen from, while the learner is at work."""
        if self.phase is Phase.LEARNING and self._option is not None:
            self._starts.draw_ahead(self._option)

    def began(self, episode: int, state: str) -> Answer:
        """Begin the demonstration that was prepared: game has begun its episode."""
        attempt = self._attempt
        assert attempt is not None, 'a demonstration was prepared'
        if self._paused:
            self._attempt = None
            return Answer(RequestStatus.PAUSED, f'the lesson is paused: {self._paused}')
        self._notice = ''
        attempt.episode, attempt.start_state, attempt.began = episode, state, self._clock()
        self._episode = episode
        for transition in list(attempt.transitions):  # came before game's answer
            self._watch(transition)
        detail = f'episode {episode} begins'
        return Answer(RequestStatus.OK, detail, episode=episode, state=state)

    def not_begun(self, status: RequestStatus, cause: str) -> Answer:
        """Abandon the demonstration: there is no episode, or its first state did not come."""
        self._abandon(cause)
        return Answer(status, cause)

    def pause(self, reason: str) -> None:
        """
        Let nothing new begin; a demonstration under way can still be ended, and is kept.

        :param reason: what is wrong and what to do; empty: go on.
        """
        self._paused = reason

    # What the game and the learner publish.

    def add_transition(self, transition: Transition) -> bool:
        """
        Add one state of the game's stream.

        :return: whether the view has changed.
        """
        if self._attempt is None:
            return False
        self._attempt.add(transition)
        return self._watch(transition)

    def game_restarted(self) -> bool:
        """
        Abandon the demonstration under way: its episode ended with the game.

        :return: whether the view has changed.
        """
        changed, self._episode = self._episode != 0, 0  # a new game counts its episodes anew
        if self._under_way is not None:
            self._abandon('The demonstration was abandoned: the game was restarted.')
        return changed

    def resume(self, participant: str, session: str) -> Answer:
        """
        Go on with a session that an earlier process has left open.

        The newest demonstration may not have reached the learner.
        """
        answer = self.carry_out(OpenSession(participant, session))
        if answer.ok:
            self._notice = 'The lesson was restarted; a demonstration under way was abandoned.'
            self._learning.awaited = self._option.newest if self._option is not None else None
        return answer

    def reached(self, episode: int, step: int) -> bool:
        """Return whether a state has arrived, or can no longer arrive."""
        if self._attempt is None or self._attempt.episode != episode:
            return True
        newest_episode, newest_step = self._attempt.here
        return newest_episode == episode and newest_step >= step

    def update_summaries(self, summaries: Sequence[OptionSummary]) -> None:
        """Keep what the learner knows of every option."""
        self._learning.update(summaries)
        self._learning.go_on(self._option)

    def update_option(self, participant: str, option_name: str, text: str) -> None:
        """
        Keep an option as the learner publishes it.

        :raises OptionError: it is not an option, or one of another domain.
        """
        if self._starts.learned(participant, option_name, text):
            self._learning.go_on(self._option)

    def learner_refused(self, uuid: str, detail: str) -> None:
        """Go on without a demonstration that the learner did not take; it stays in the store."""
        if uuid == self.awaited:
            self._wait_no_more(_REFUSED, detail)

    def learner_silent(self) -> None:
        """Go on without the learner, which has not answered in time."""
        self._wait_no_more(_SILENT)

    def _wait_no_more(self, notices: dict[bool, str], detail: str = '') -> None:
        if (demo := self._learning.awaited) is not None:
            self._notice = notices[demo.withdrawn].format(detail=detail)
            self._learning.await_none(self._option)

    # How requests are carried out; each raises RefusalError where it is refused.

    @property
    def _spent(self) -> bool:
        option, budget = self._option, self._starts.rules.budget
        return option is not None and len(option.demonstrations) >= budget

    @property
    def _question_id(self) -> int:
        """Of the open question: counted on over all options, so that none is used twice; or 0."""
        if self._option is None or self._option.questions.open is None:
            return 0
        return self._history.n_answers + 1

    @property
    def _who(self) -> tuple[str, str, str, str]:
        """What every entry begins with: domain, its parameters, participant and session."""
        return (*self._history.key, self._history.participant, self._session)

    def _advice(self, phase: Phase) -> str:
        """Return what to do next, in words, and why where that is not obvious."""
        option, summary = self._option, self._learning.settled(self._option)
        hint = _HINTS[phase]
        if self._paused and phase not in (Phase.DEMONSTRATING, Phase.LEARNING):
            hint = 'The lesson is paused.'
        if phase is Phase.FINISHED and option is not None:
            budget = self._starts.rules.budget
            spent = f'The budget of {budget} is used up. ' if self._spent else ''
            met = 'Not all criteria are met.' if summary is None else summary.result
            return f'{spent}{met} {_HINTS[phase]}'
        ready = phase in (Phase.READY, Phase.DEMONSTRATING) and not self._learning.done
        if ready and summary is not None:
            return f'{summary.result[:-1]}, but from some starts it still fails. {hint}'
        return hint

    def _check_free(self, *, learned: bool = False) -> None:
        """
        Check that no demonstration is under way.

        :param learned: the learner must not be working on one either.
        """
        if self._attempt is not None:
            who = self._history.participant
            raise _wrong_phase(f'{who} has a demonstration under way; end it first')
        if learned and self._learning.awaited is not None:
            raise _wrong_phase('the learner is still working on a demonstration; wait for it')

    def _entries(self, participant: str) -> tuple[Entry, ...]:
        try:
            return self._store.entries(participant)
        except StoreError as error:
            raise RefusalError(RequestStatus.NOT_SAVED, str(error)) from error

    def _demonstrations(self, *participants: str) -> list[Demonstration]:
        return each_once(
            entry
            for participant in participants
            for entry in self._entries(participant)
            if isinstance(entry, Demonstration)
            and (entry.domain, entry.domain_parameters) == self._history.key
        )

    def _write(self, *entries: Entry, history: History | None = None) -> None:
        try:
            self._store.append(*entries)
        except StoreError as error:
            raise RefusalError(RequestStatus.NOT_SAVED, str(error)) from error
        for entry in entries:
            (history or self._history).add(entry)

    def _open_session(self, request: OpenSession) -> Answer:
        """Begin a session, or go on with it where it was left."""
        self._check_free()
        participant, session = request.participant, request.session
        for what, code in (('participant', participant), ('session', session or 'new')):
            if not CODE.fullmatch(code):
                detail = f'{what} {code!r} is not a code: {CODE_RULE}'
                raise RefusalError(RequestStatus.BAD_NAME, detail)
        if similar := similar_code(participant, self._store.participants()):
            detail = (
                f'{participant!r} differs only in case from {similar!r}: give {similar!r}, '
                'or another code'
            )
            raise RefusalError(RequestStatus.BAD_NAME, detail)
        history = History(self._domain, participant, self._entries(participant))
        codes = (f'{self._today()}-{number}' for number in count(1))
        session = session or next(code for code in codes if code not in history.sessions)
        self._write(SessionOpened(*history.key, participant, session), history=history)
        self._history, self._session = history, session
        self._turn_to(history.options.get(history.sessions[session]))
        return Answer(
            RequestStatus.OK,
            f'session {session} of {participant} is open',
            session=session,
            known_options=tuple(history.options),
        )

    def _define_option(self, request: DefineOption) -> Answer:
        """Name an option to teach, or take it up again."""
        self._check_free()
        if not self._history.participant:
            raise _wrong_phase('open a session first')
        name = composed(request.name.strip())
        if fault := option_name_fault(name):
            raise RefusalError(RequestStatus.BAD_NAME, fault)
        resumed = name in self._history.options
        method = request.method or (resumed and self._history.options[name].method)
        try:
            check_method(method or self._starts.rules.method, self._domain)
        except DemonstrationError as error:
            raise RefusalError(RequestStatus.BAD_METHOD, str(error)) from error
        self._write(OptionDefined(*self._who, name, request.ask_again, request.method))
        self._turn_to(self._history.options[name])
        text = f'{"going on with" if resumed else "begun"}: {name}'
        return Answer(RequestStatus.OK, text, resumed=resumed)

    def _turn_to(self, option: OptionHistory | None) -> None:
        if option is not self._option:
            self._learning.awaited, self._again = None, ''
        self._option, self._notice = option, ''
        self._learning.check_done(option)

    def _answer_question(self, request: AnswerQuestion) -> Answer:
        """Answer the open question, or take back the last answer, so that its question is open."""
        option = self._option
        feature = option.questions.open if option is not None else None
        asked = self._attempt is None and request.question_id == self._question_id
        if option is None or (feature is None and not request.back) or self._attempt is not None:
            raise RefusalError(RequestStatus.NOT_ASKED, 'no question is open')
        if request.back:
            if not asked or not option.questions.answers:
                detail = 'there is no question before this one to go back to'
                raise RefusalError(RequestStatus.NOT_ASKED, detail)
            self._write(AnswerTakenBack(*self._who, option.name))
            answer = Answer(RequestStatus.OK, 'the question before is open again')
        else:
            assert feature is not None
            if not asked:
                raise RefusalError(
                    RequestStatus.NOT_ASKED,
                    f'question {request.question_id} is not open; question {self._question_id} '
                    f'is, about {feature.name}',
                )
            self._write(FeatureAnswered(*self._who, option.name, feature.name, request.yes))
            answer = Answer(RequestStatus.OK, f'{feature.name}: {"yes" if request.yes else "no"}')
            if not option.questions.answers:
                answer = Answer(RequestStatus.NO_FEATURE, _ALL_NO)
        self._notice = '' if answer.ok else answer.detail
        self._learning.check_done(option)
        return answer

    def _prepare(self, request: BeginDemonstration) -> Answer:
        option = self._option
        if self._attempt is not None:
            raise _wrong_phase('a demonstration is under way; end it first')
        phase = self.phase
        if option is None or phase not in (Phase.READY, Phase.FINISHED) or self._spent:
            spent = self._spent and phase is Phase.FINISHED
            status = RequestStatus.BUDGET_SPENT if spent else RequestStatus.WRONG_PHASE
            raise RefusalError(status, self._advice(phase))
        if not can_simulate(self._domain):
            state = request.start_state  # for the game to judge; empty: where it is now
        elif request.start_state:
            try:
                decoded = self._domain.decode(request.start_state)
            except DomainError as error:
                raise RefusalError(RequestStatus.BAD_STATE, str(error)) from error
            if self._domain.is_over(decoded):
                detail = f'the task is over in {request.start_state}: nothing can be shown there'
                raise RefusalError(RequestStatus.BAD_STATE, detail)
            state = self._domain.encode(decoded)
        else:
            state = self._again or next(reversed(option.start_states), '')
            state = state or self._starts.draw(option)
        self._attempt = Attempt(state, request.watch)
        seed = self._starts.episode_seed(option)
        return Answer(RequestStatus.OK, 'the start state is chosen', state=state, seed=seed)

    def _watch(self, transition: Transition) -> bool:
        """Look at one state of the stream; return whether the view has changed."""
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
            self._again = self._under_way.start_state
        self._attempt = None
        self._notice = notice

    def _end_demonstration(self, request: EndDemonstration) -> Answer:
        attempt, option = self._under_way, self._option
        if attempt is None or option is None:
            raise _wrong_phase('no demonstration is under way; begin one first')
        attempt.check(request)
        if request.verdict is Verdict.DISCARD:
            self._abandon('')
            detail = 'discarded; the same start state can be tried again'
            return Answer(RequestStatus.OK, detail)
        demo = attempt.demonstration(
            self._who,
            option,
            tuple(feature.name for feature in self._domain.features),
            request,
            seconds=round(self._clock() - attempt.began, 3),
            method=self._learning.method(option),
        )
        try:
            check_demonstration(demo, self._domain)
        except DemonstrationError as error:
            self._abandon(f'The demonstration was refused and discarded: {error}.')
            raise RefusalError(RequestStatus.REFUSED, str(error)) from error
        found = contradiction(demo, option.demonstrations, self._domain)
        self._write(demo)
        self._attempt, self._again, self._notice = None, '', ''
        self._learning.awaited = demo
        text = f'demonstration {demo.number} of {demo.option_name} is kept'
        if self._paused:
            self._notice = f'The demonstration is {_UNRECORDED}.'
            text = f'{text} {_UNRECORDED}'
        answer = Answer(RequestStatus.OK, text, uuid=demo.uuid, unsent=(demo,))
        if found is None:
            return answer
        return replace(
            answer,
            contradiction=found.text,
            contradicts=found.earlier.uuid,
            situation=demo.states[found.step],
        )

    def _withdraw(self, request: WithdrawDemonstration) -> Answer:
        """Withdraw a demonstration of the option."""
        self._check_free(learned=True)
        if self._option is None:
            raise _wrong_phase('name the option first')
        name, demonstrations = self._option.name, self._option.demonstrations
        if not demonstrations:
            detail = f'{name} has no demonstration to withdraw'
            raise RefusalError(RequestStatus.NO_DEMONSTRATION, detail)
        wanted = request.uuid or demonstrations[-1].uuid
        demo = next((demo for demo in demonstrations if demo.uuid == wanted), None)
        if demo is None:
            detail = f'{name} has no demonstration {wanted}, or it is withdrawn already'
            raise RefusalError(RequestStatus.NO_DEMONSTRATION, detail)
        withdrawn = replace(demo, withdrawn=True)
        self._write(withdrawn)
        self._again = self._notice = ''  # the option's history has the start state
        self._learning.awaited = withdrawn
        steps = len(demo.actions)
        what = f'the demonstration of {steps} step{"s"[: steps != 1]}' if steps else '"not here"'
        text = f'{what} is withdrawn; its start comes again'
        return Answer(RequestStatus.OK, text, uuid=withdrawn.uuid, unsent=(withdrawn,))

    def _list(self, request: ListDemonstrations) -> Answer:
        """List the demonstrations of an option, also those that were withdrawn."""
        option = self._known(request.option_name) if request.option_name else self._option
        if option is None:
            raise RefusalError(RequestStatus.NO_OPTION, 'no option is being taught: name one')
        everything = self._demonstrations(self._history.participant)
        found = tuple(demo for demo in everything if demo.option_name == option.name)
        return Answer(RequestStatus.OK, f'{len(found)} of {option.name}', demonstrations=found)

    def _known(self, option_name: str) -> OptionHistory:
        option = self._history.options.get(composed(option_name))
        if option is None:
            detail = f'unknown option {option_name!r} of {self._history.participant or "no one"}'
            raise RefusalError(RequestStatus.NO_OPTION, detail)
        return option

    def _change_option(self, request: ChangeOption) -> Answer:
        """Delete an option; or rename it: begin it anew with its answers and demonstrations."""
        self._check_free(learned=True)
        option, new = self._known(request.name), composed(request.new_name.strip())
        begun: list[Entry] = []
        moved: list[Demonstration] = []
        if request.new_name:
            if fault := option_name_fault(new):
                raise RefusalError(RequestStatus.BAD_NAME, fault)
            if new in self._history.options:
                detail = f'an option is called {new!r} already'
                raise RefusalError(RequestStatus.NAME_TAKEN, detail)
            begun.append(OptionDefined(*self._who, new, ask_again=False, method=option.method))
            answers = option.questions.answers.items()
            begun += [FeatureAnswered(*self._who, new, *answer) for answer in answers]
            moved = [
                with_uuid(replace(demo, option_name=new, number=number))
                for number, demo in enumerate(option.demonstrations, self._history.number(new))
            ]
        withdrawn = [replace(demo, withdrawn=True) for demo in option.demonstrations]
        self._write(*begun, *moved, *withdrawn, OptionDeleted(*self._who, option.name))
        if new or option is self._option:
            self._turn_to(self._history.options.get(new))
        if moved:
            self._learning.awaited = moved[-1]
        return Answer(
            RequestStatus.OK,
            f'{option.name} is now called {new}' if new else f'{option.name} is deleted',
            known_options=tuple(self._history.options),
            unsent=(*moved, *withdrawn),
        )


def _wrong_phase(detail: str) -> RefusalError:
    return RefusalError(RequestStatus.WRONG_PHASE, detail)
