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

from humanopts_env.domains.base import Domain, DomainError
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
from humanopts_learner.summary import NO_RANGE, OptionSummary
from humanopts_ros.limits import composed
from humanopts_teach.lesson.attempt import Attempt, with_uuid
from humanopts_teach.lesson.history import History, OptionHistory
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

_ALL_NO = 'Every answer was no, but an option depends on something: they are asked again.'
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
_GAME_AGAIN = 'The demonstration is given up: the game was started again.'
_RESUMED = 'The lesson was started again; a demonstration that was under way is given up.'
_HINTS = {
    Phase.NO_SESSION: 'Open a session to begin.',
    Phase.NO_OPTION: 'Name the option that you want to teach.',
    Phase.ASKING: 'Answer the question.',
    Phase.READY: 'Begin the next demonstration.',
    Phase.DEMONSTRATING: 'Show the option, then say done; or say not here, or discard.',
    Phase.LEARNING: 'The learner works on the demonstration.',
    Phase.FINISHED: 'Name the next option to teach.',
}
_FAILS = ', but from some starts it still fails.'
_GOES_ON = (Phase.DEMONSTRATING, Phase.LEARNING)  # also while the lesson is paused


class Lesson:
    """One participant at a time, one option at a time, one demonstration at a time."""

    def __init__(
        self,
        domain: Domain[Any],
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
        self._participant = self._session = ''
        self._history = History(domain)
        self._option: OptionHistory | None = None
        self._attempt: Attempt | None = None  # from the request for an episode on
        self._episode = 0  # of the newest demonstration that was begun
        self._again = ''  # start state of a demonstration that came to nothing
        self._learned: dict[tuple[str, str], OptionSummary] = {}  # by participant and option
        self._awaited: Demonstration | None = None  # the learner has not counted it in, or out
        self._done = False  # criteria met, and the strategy has nothing left to ask
        self._notice = ''
        self._paused = ''  # why nothing new can be begun; empty: it can

    # What can be read.

    @property
    def phase(self) -> Phase:
        """Where the lesson stands."""
        if not self._participant:
            return Phase.NO_SESSION
        if self._option is None:
            return Phase.NO_OPTION
        if self._under_way is not None:
            return Phase.DEMONSTRATING
        if self._option.questions.open is not None:
            return Phase.ASKING
        if self._awaited is not None:
            return Phase.LEARNING
        return Phase.FINISHED if self._done or self._spent else Phase.READY

    @property
    def _under_way(self) -> Attempt | None:
        """The demonstration under way; None: no episode of one has begun."""
        return self._attempt if self._attempt is not None and self._attempt.episode else None

    @property
    def awaited(self) -> str:
        """The uuid of the demonstration that the learner works on; empty: none."""
        return self._awaited.uuid if self._awaited is not None else ''

    @property
    def _settled(self) -> OptionSummary | None:
        """The learner's report that all criteria that can be measured hold, as taught now."""
        if self._option is None:
            return None
        known = self._learned.get((self._participant, self._option.name))
        holds = (
            known is not None
            and known.settled
            and self._counts_nothing_withdrawn(known, self._option)
            and known.method == self._method(self._option)
            and set(known.features) == set(self._option.questions.chosen)
        )
        return known if holds else None

    @property
    def criteria_met(self) -> bool:
        """Whether the learner reports that they hold, with the features and method of now."""
        return self._settled is not None and self._settled.criteria_met

    @property
    def view(self) -> LessonView:
        """Everything that a terminal shows."""
        view = LessonView(
            phase=self.phase,
            participant=self._participant,
            session=self._session,
            budget=self._starts.rules.budget,
            strategy=self._starts.rules.strategy,
            paused=self._paused,
        )
        option, attempt = self._option, self._under_way
        if option is not None:
            feature = option.questions.open
            view = replace(
                view,
                option_name=option.name,
                question_id=self._question_id,
                question=option.questions.text,
                question_feature=feature.name if feature is not None else '',
                questions_total=len(self._domain.features),
                chosen_features=option.questions.chosen,
                earlier_features=option.questions.earlier if feature is not None else (),
                method=self._method(option),
                n_demonstrations=option.n_trajectories,
                n_not_here=len(option.demonstrations) - option.n_trajectories,
                last_uuid=option.newest.uuid if option.newest is not None else '',
                start_state=attempt.start_state if attempt is not None else '',
                episode=self._episode,
                machine_steps=attempt.machine_steps if attempt is not None else 0,
                criteria_met=self.criteria_met,
            )
        goes_on = view.phase in (Phase.READY, Phase.DEMONSTRATING) and not self._done
        reached = _reached(self._settled)
        why = f'{reached[:-1]}{_FAILS}' if goes_on and self._settled is not None else ''
        return replace(
            view, text=' '.join(filter(None, (self._notice, why, _hint(view, reached))))
        )

    def demonstrations(self) -> list[Demonstration]:
        """
        Return the demonstrations of all participants in this domain, each once.

        Of one that was taken back, only the withdrawal is returned.

        :raises RefusalError: a file of theirs cannot be read.
        """
        return self._demonstrations(*self._store.participants())

    def _demonstrations(self, *participants: str) -> list[Demonstration]:
        return each_once(
            entry
            for participant in participants
            for entry in self._entries(participant)
            if isinstance(entry, Demonstration)
            and (entry.domain, entry.domain_parameters) == self._history.key
        )

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
            return carry_out[type(request)](request)
        except RefusalError as refusal:
            return refusal.answer

    def draw_ahead(self) -> None:
        """Draw what the next start state is chosen from, while the learner is at work."""
        if self.phase is Phase.LEARNING and self._option is not None:
            self._starts.draw_ahead(self._participant, self._option)

    def began(self, episode: int, state: str) -> Answer:
        """Begin the demonstration that was prepared: game has begun its episode."""
        attempt = self._attempt
        assert attempt is not None, 'a demonstration was prepared'
        if self._paused:
            self._attempt = None
            return self._refusal_while_paused().answer
        self._notice = ''
        attempt.episode, attempt.start_state, attempt.began = episode, state, self._clock()
        self._episode = episode
        for transition in list(attempt.transitions):  # came before game's answer
            self._watch(transition)
        detail = f'episode {episode} begins'
        return Answer(RequestStatus.OK, detail, episode=episode, state=state)

    def not_begun(self, status: RequestStatus, cause: str) -> Answer:
        """Give up the demonstration: there is no episode, or its first state did not come."""
        self._give_up(cause)
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
        Give up the demonstration under way: a game that is started again is another one.

        :return: whether the view has changed.
        """
        changed, self._episode = self._episode != 0, 0  # it counts its episodes anew
        if self._under_way is not None:
            self._give_up(_GAME_AGAIN)
        return changed

    def resume(self, participant: str, session: str) -> Answer:
        """
        Go on with a session in whose middle the process of the lesson has ended.

        The newest demonstration may not have reached the learner.
        """
        answer = self.carry_out(OpenSession(participant, session))
        if answer.ok:
            self._notice = _RESUMED
            self._awaited = self._option.newest if self._option is not None else None
        return answer

    def reached(self, episode: int, step: int) -> bool:
        """Return whether the stream has come so far, or waiting for it is of no use."""
        if self._attempt is None or self._attempt.episode != episode:
            return True
        newest_episode, newest_step = self._attempt.here
        return newest_episode == episode and newest_step >= step

    def update_summaries(self, options: Sequence[OptionSummary]) -> None:
        """Keep what the learner knows of every option."""
        self._learned = {(status.participant, status.option_name): status for status in options}
        self._go_on()

    def update_option(self, participant: str, option_name: str, text: str) -> None:
        """
        Keep an option as the learner publishes it.

        :raises OptionError: it is not an option, or one of another domain.
        """
        if self._starts.learned(participant, option_name, text):
            self._go_on()

    def learner_refused(self, uuid: str, detail: str) -> None:
        """Go on without a demonstration that the learner did not take; it stays in the store."""
        if self._awaited is not None and self._awaited.uuid == uuid:
            self._wait_no_more(_REFUSED[self._awaited.withdrawn].format(detail=detail))

    def learner_silent(self) -> None:
        """Go on without the learner, which has not answered in time."""
        if self._awaited is not None:
            self._wait_no_more(_SILENT[self._awaited.withdrawn])

    def _go_on(self) -> None:
        """Go on where both learner and start states have counted the newest demonstration."""
        option, demo = self._option, self._awaited
        if option is not None and demo is not None:
            known = self._learned.get((demo.participant, demo.option_name))
            if demo.withdrawn:
                done = known is None or self._counts_nothing_withdrawn(known, option)
            else:
                done = known is not None and known.last_uuid == demo.uuid
            if not done or not self._starts.counts(option, demo):
                return
            self._awaited = None
        self._check_done()

    def _counts_nothing_withdrawn(self, known: OptionSummary, option: OptionHistory) -> bool:
        counted = known.n_demonstrations + known.n_not_here
        return known.last_uuid not in option.withdrawn and counted <= len(option.demonstrations)

    def _wait_no_more(self, notice: str) -> None:
        self._awaited, self._notice = None, notice
        self._check_done()

    def _check_done(self) -> None:
        option = self._option
        self._done = (
            option is not None
            and self._settled is not None
            and self._starts.exhausted(self._participant, option)
        )

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
        return (*self._history.key, self._participant, self._session)

    def _check_free(self) -> None:
        if self._paused:
            raise self._refusal_while_paused()
        if self._attempt is not None:
            who = self._participant
            raise _wrong_phase(f'{who} has a demonstration under way; it has to be ended first')

    def _refusal_while_paused(self) -> RefusalError:
        return RefusalError(RequestStatus.PAUSED, f'the lesson is paused: {self._paused}')

    def _entries(self, participant: str) -> tuple[Entry, ...]:
        try:
            return self._store.entries(participant)
        except StoreError as error:
            raise RefusalError(RequestStatus.NOT_SAVED, str(error)) from error

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
        history = History(self._domain, self._entries(participant))
        codes = (f'{self._today()}-{number}' for number in count(1))
        session = session or next(code for code in codes if code not in history.sessions)
        self._write(SessionOpened(*history.key, participant, session), history=history)
        self._history, self._participant, self._session = history, participant, session
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
        if not self._participant:
            raise _wrong_phase('open a session first')
        name = composed(request.name.strip())
        if fault := option_name_fault(name):
            raise RefusalError(RequestStatus.BAD_NAME, fault)
        known = self._history.options.get(name)
        before = known.method if known is not None else ''
        method = request.method or before or self._starts.rules.method
        try:
            check_method(method, self._domain)
        except DemonstrationError as error:
            raise RefusalError(RequestStatus.BAD_METHOD, str(error)) from error
        resumed = known is not None
        self._write(OptionDefined(*self._who, name, request.ask_again, request.method))
        self._turn_to(self._history.options[name])
        text = f'{"going on with" if resumed else "begun"}: {name}'
        return Answer(RequestStatus.OK, text, resumed=resumed)

    def _method(self, option: OptionHistory) -> str:
        return option.method or self._starts.rules.method

    def _turn_to(self, option: OptionHistory | None) -> None:
        if option is not self._option:
            self._awaited, self._again = None, ''
        self._option, self._notice = option, ''
        self._check_done()

    def _answer_question(self, request: AnswerQuestion) -> Answer:
        if self._paused:
            raise self._refusal_while_paused()
        option = self._option
        if request.back:
            return self._back(request, option)
        feature = option.questions.open if option is not None else None
        if self._attempt is not None or option is None or feature is None:
            raise RefusalError(RequestStatus.NOT_ASKED, 'no question is open')
        if request.question_id != self._question_id:
            raise RefusalError(
                RequestStatus.NOT_ASKED,
                f'question {request.question_id} is not open; question {self._question_id} is, '
                f'about {feature.name}',
            )
        self._write(FeatureAnswered(*self._who, option.name, feature.name, request.yes))
        self._notice = '' if option.questions.answers else _ALL_NO
        self._check_done()
        if self._notice:
            return Answer(RequestStatus.NO_FEATURE, _ALL_NO)
        return Answer(RequestStatus.OK, f'{feature.name}: {"yes" if request.yes else "no"}')

    def _back(self, request: AnswerQuestion, option: OptionHistory | None) -> Answer:
        """Take back the last answer, so that its question is open again."""
        asked = self._attempt is None and request.question_id == self._question_id
        if option is None or not asked or not option.questions.answers:
            detail = 'there is no question before this one to go back to'
            raise RefusalError(RequestStatus.NOT_ASKED, detail)
        self._write(AnswerTakenBack(*self._who, option.name))
        self._notice = ''
        self._check_done()
        return Answer(RequestStatus.OK, 'the question before is open again')

    def _prepare(self, request: BeginDemonstration) -> Answer:
        if self._paused:
            raise self._refusal_while_paused()
        option = self._option
        if self._attempt is not None:
            raise _wrong_phase('a demonstration is under way; end it first')
        if option is None or self.phase not in (Phase.READY, Phase.FINISHED) or self._spent:
            spent = self._spent and self.phase is Phase.FINISHED
            status = RequestStatus.BUDGET_SPENT if spent else RequestStatus.WRONG_PHASE
            raise RefusalError(status, _hint(self.view, _reached(self._settled)))
        state = self._start_state(request.start_state, option)
        self._attempt = Attempt(state, request.watch)
        seed = self._starts.episode_seed(self._participant, option)
        return Answer(RequestStatus.OK, 'the start state is chosen', state=state, seed=seed)

    def _start_state(self, asked_for: str, option: OptionHistory) -> str:
        if not asked_for:
            again = self._again or next(reversed(option.start_states), '')
            return again or self._starts.draw(self._participant, option)
        try:
            state = self._domain.decode(asked_for)
        except DomainError as error:
            raise RefusalError(RequestStatus.BAD_STATE, str(error)) from error
        if self._domain.is_over(state):
            detail = f'the task is over in {asked_for}: nothing can be shown from there'
            raise RefusalError(RequestStatus.BAD_STATE, detail)
        return self._domain.encode(state)

    def _watch(self, transition: Transition) -> bool:
        """Look at one state of the stream; return whether the view has changed."""
        attempt = self._under_way
        if attempt is None:
            return False
        if cause := attempt.invalidated_by(transition):
            self._give_up(f'The demonstration is given up: {cause}.')
            return True
        over = transition.terminated or transition.truncated
        if over and transition.episode == attempt.episode:
            self._notice = _OVER if transition.terminated else _AT_LIMIT
            return True
        return transition.action_source is Source.MACHINE

    def _give_up(self, notice: str) -> None:
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
            self._give_up('')
            detail = 'discarded; the same start state can be tried again'
            return Answer(RequestStatus.OK, detail)
        demo = attempt.demonstration(
            self._who,
            option,
            tuple(feature.name for feature in self._domain.features),
            request,
            seconds=round(self._clock() - attempt.began, 3),
            method=self._method(option),
        )
        try:
            check_demonstration(demo, self._domain)
        except DemonstrationError as error:
            self._give_up(f'The demonstration was refused and discarded: {error}.')
            raise RefusalError(RequestStatus.REFUSED, str(error)) from error
        found = contradiction(demo, option.demonstrations, self._domain)
        self._write(demo)
        self._attempt, self._again, self._notice = None, '', ''
        self._awaited = demo
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
        """Take back a demonstration of the option."""
        self._check_free()
        if self._awaited is not None:
            raise _wrong_phase('the learner still works on a demonstration; wait for it')
        if self._option is None:
            raise _wrong_phase('name the option first')
        name, demonstrations = self._option.name, self._option.demonstrations
        if not demonstrations:
            detail = f'no demonstration of {name} is left to take back'
            raise RefusalError(RequestStatus.NO_DEMONSTRATION, detail)
        wanted = request.uuid or demonstrations[-1].uuid
        demo = next((demo for demo in demonstrations if demo.uuid == wanted), None)
        if demo is None:
            detail = f'{wanted} is no demonstration of {name} that counts'
            raise RefusalError(RequestStatus.NO_DEMONSTRATION, detail)
        withdrawn = replace(demo, withdrawn=True)
        self._write(withdrawn)
        self._again = self._notice = ''  # the option's history has the start state
        self._awaited = withdrawn
        steps = len(demo.actions)
        plural = 's' if steps > 1 else ''
        what = f'the demonstration of {steps} step{plural}' if steps else 'the "not here"'
        text = f'{what} is taken back; its start comes again'
        return Answer(RequestStatus.OK, text, uuid=withdrawn.uuid, unsent=(withdrawn,))

    def _list(self, request: ListDemonstrations) -> Answer:
        """List the demonstrations of an option, also those that were taken back."""
        option = self._known(request.option_name) if request.option_name else self._option
        if option is None:
            raise RefusalError(RequestStatus.NO_OPTION, 'no option is taught now: name one')
        found = self._demonstrations(self._participant)
        found = [demo for demo in found if demo.option_name == option.name]
        return Answer(
            RequestStatus.OK, f'{len(found)} of {option.name}', demonstrations=tuple(found)
        )

    def _known(self, option_name: str) -> OptionHistory:
        option = self._history.options.get(composed(option_name))
        if option is None:
            detail = f'{self._participant or "nobody"} has no option {option_name!r}'
            raise RefusalError(RequestStatus.NO_OPTION, detail)
        return option

    def _change_option(self, request: ChangeOption) -> Answer:
        """Delete an option; or rename it: begin it anew with its answers and demonstrations."""
        self._check_free()
        if self._awaited is not None:
            raise _wrong_phase('the learner still works on a demonstration; wait for it')
        option, new = self._known(request.name), composed(request.new_name.strip())
        begun: list[Entry] = []
        moved: list[Demonstration] = []
        if request.new_name:
            if fault := option_name_fault(new):
                raise RefusalError(RequestStatus.BAD_NAME, fault)
            if new in self._history.options:
                detail = f'there is an option {new!r} already'
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
            self._awaited = moved[-1]
        return Answer(
            RequestStatus.OK,
            f'{option.name} is now called {new}' if new else f'{option.name} is deleted',
            known_options=tuple(self._history.options),
            unsent=(*moved, *withdrawn),
        )


def _wrong_phase(detail: str) -> RefusalError:
    return RefusalError(RequestStatus.WRONG_PHASE, detail)


def _reached(settled: OptionSummary | None) -> str:
    """Return which criteria hold, in words."""
    if settled is None:
        return 'Not all criteria hold.'
    if settled.criteria_met:
        return 'All criteria hold.'
    return f'The return cannot be measured: {NO_RANGE}. The other criteria hold.'


def _hint(view: LessonView, reached: str) -> str:
    """
    Return what to do next, in words; where an option is finished, why.

    :param reached: which criteria hold.
    """
    still = view.paused and view.phase not in _GOES_ON
    words = 'The lesson is paused.' if still else _HINTS[view.phase]
    if view.phase is not Phase.FINISHED:
        return words
    given = view.n_demonstrations + view.n_not_here
    spent = f'The budget of {view.budget} is spent. ' if given >= view.budget else ''
    return f'{spent}{reached} {words}'
