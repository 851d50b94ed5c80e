"""The lesson: any order of requests, demonstrations and judged runs, against a model."""

from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from humanopts_env.game import Source
from humanopts_learner.demonstrations import (
    check_demonstration,
    GOAL,
    judged,
    Kind,
    shown,
    TREES,
)
from humanopts_learner.options.checks import Check
from humanopts_learner.summary import Criterion, OptionSummary
from humanopts_teach.lesson.history import OptionHistory
from humanopts_teach.lesson.requests import (
    Answer,
    AnswerQuestion,
    BeginDemonstration,
    ChangeOption,
    DefineOption,
    EndDemonstration,
    LessonRequest,
    OpenSession,
    Phase,
    RequestStatus,
    Verdict,
    WithdrawDemonstration,
)
from humanopts_teach.lesson.store import DemonstrationStore
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import initialize, invariant, precondition, rule, RuleBasedStateMachine
import pytest
from teach_support.lesson import (
    Drawn,
    fill_disk,
    not_here,
    OTHER,
    START,
    Table,
    TAXI,
)

OK, WRONG, MACHINE = RequestStatus.OK, RequestStatus.WRONG_PHASE, Source.MACHINE
FEATURES = [feature.name for feature in TAXI.features]
BUDGET, EXAM = 4, 2
READY = Phase.READY, Phase.CHECKING, Phase.EXAM, Phase.FINISHED
RARELY = st.sampled_from([True, False, False, False])  # what begins anew
NAMES = st.sampled_from(['go', 'fetch', 'leave'])
Key = tuple[str, str]  # participant and option


@dataclass(frozen=True)
class Judged:
    """What the model knows of a run that was judged."""

    right: bool
    exam: bool
    version: frozenset[str]  # of the option that ran: what was shown before
    start: str  # of the next demonstration, if it is wrong


@dataclass
class Taught:
    """What the model knows of an option."""

    number: int = 1  # of the next demonstration
    method: str = ''
    answers: list[bool] = field(default_factory=list)
    earlier: tuple[str, ...] = ()
    shown: dict[str, str] = field(default_factory=dict)  # start state by uuid, the oldest first
    not_here: set[str] = field(default_factory=set)
    withdrawn: dict[str, str] = field(default_factory=dict)
    starts: list[str] = field(default_factory=list)  # withdrawn, to be shown anew
    judged: dict[str, Judged] = field(default_factory=dict)  # by uuid, the oldest first
    taken_back: set[str] = field(default_factory=set)  # uuids of judged runs

    @property
    def verdicts(self) -> dict[str, Judged]:
        now = self.shown.keys()
        return {uuid: run for uuid, run in self.judged.items() if run.version == now}

    @property
    def wrong(self) -> str:
        """Where the next demonstration starts after a wrong run."""
        starts = [run.start for run in self.verdicts.values() if not run.right]
        return starts[-1] if starts else ''

    @property
    def n_questions(self) -> int:
        return sum(not run.exam for run in self.judged.values())

    @property
    def asked(self) -> bool:
        """Whether the question about a run was answered."""
        return any(not run.exam for run in self.verdicts.values())

    @property
    def chosen(self) -> tuple[str, ...]:
        return tuple(name for name, yes in zip(FEATURES, self.answers) if yes)


ASKED = 'taxi 2,2 passenger aboard destination B'


class Asked(Drawn):
    """One question about a run of each version, and exams that start in one state."""

    def check(
        self, option: OptionHistory, names: Collection[str] = (), *, every_end: bool = False
    ) -> Check | None:
        if any(not run.exam for run in option.verdicts):
            return None
        return not_here(ASKED)

    def draw_for_exam(self, option: OptionHistory, names: Collection[str] = ()) -> str:
        return OTHER


class LessonMachine(RuleBasedStateMachine):
    """Requests and news in any order; the model holds what must come of them."""

    def __init__(self) -> None:
        super().__init__()
        self.folder = TemporaryDirectory()
        self.store = DemonstrationStore(Path(self.folder.name))
        self.options: dict[Key, Taught] = {}
        self.numbers: dict[Key, int] = {}  # of options that were deleted
        self.moved: dict[str, bool] = {}  # uuids of options that were deleted: all are withdrawn
        self.sessions: dict[Key, str] = {}
        self.answered: Counter[str] = Counter()
        self.drawn: dict[tuple[Key, int], str] = {}
        self.who = self.session = self.name = ''
        self.episode = 0
        self._start_lesson()

    def _start_lesson(self) -> None:
        self.table = Table(self.store, budget=BUDGET, starts=Asked)
        self.reports: dict[Key, tuple[OptionSummary, bool]] = {}
        self.exam = False  # whether a run in it is under way
        self.path: list[tuple[str, Source]] = []  # of the demonstration under way
        self.watch = False
        self.awaited = self.again = ''

    def teardown(self) -> None:
        self.store.close()
        self.folder.cleanup()

    @property
    def taught(self) -> Taught | None:
        return self.options.get((self.who, self.name))

    def ask(self, request: LessonRequest, expected: RequestStatus) -> Answer:
        """Ask, with a full disk first: that changes nothing, and can be tried again."""
        before, entries = self.table.lesson.view, self.store.entries(self.who)
        if not isinstance(request, BeginDemonstration) and expected is OK:
            with pytest.MonkeyPatch.context() as patch:
                fill_disk(patch)
                writes = not (isinstance(request, EndDemonstration) and
                              request.verdict is Verdict.DISCARD)  # fmt: skip
                if writes:
                    assert self.table.ask(request).status is RequestStatus.NOT_SAVED
                    assert self.table.lesson.view == before
        answer = self.table.ask(request)
        assert answer.status is expected, answer
        if not answer.carried_out:
            assert (self.table.lesson.view, self.store.entries(self.who)) == (before, entries)
        return answer

    @initialize(stage=st.sampled_from([1, 2, 2, 3, 4, 5, 5, 6, 0]))
    def begin_lesson(self, stage: int) -> None:
        if stage > 0:
            self.open('p1', 's1')
            self.define('go', False, '')
            self.answer(True, True, 0)
        if stage > 1:
            self.show(['north'], stage > 2)
        if stage > 3:
            self.answer(True, True, 0)
            self.report(True)
        for _ in range(stage - 4):
            self.examine(2, True, False)

    def turn_to(self, name: str, *, anew: bool = False) -> None:
        if anew or name != self.name:
            self.awaited = self.again = ''
        self.name = name if (self.who, name) in self.options else ''

    @rule(
        who=st.sampled_from(['p1', 'p1', 'p2']),
        session=st.sampled_from(['s1', 's1', 's2']),
        now=RARELY,
    )
    def open(self, who: str, session: str, now: bool = True) -> None:
        if not now:
            return
        self.ask(OpenSession(who, session), WRONG if self.path else OK)
        if not self.path:
            self.who, self.session = who, session
            self.turn_to(self.sessions.setdefault((who, session), ''), anew=True)

    @rule(
        name=NAMES,
        again=st.sampled_from([False, False, True]),
        method=st.sampled_from(['', '', GOAL, TREES]),
        now=RARELY,
    )
    def define(self, name: str, again: bool, method: str, now: bool = True) -> None:
        if not now:
            return
        free = self.who and not self.path
        answer = self.ask(DefineOption(name, again, method), OK if free else WRONG)
        if free:
            key = self.who, name
            assert answer.resumed == (key in self.options)
            option = self.options.setdefault(key, Taught(self.numbers.get(key, 1)))
            option.method = method or option.method
            if again:
                complete = len(option.answers) == len(FEATURES)
                option.earlier = option.chosen if complete else option.earlier
                option.answers = []
            self.sessions[self.who, self.session] = name
            self.turn_to(name)

    @rule(yes=st.booleans(), rest=st.booleans(), stale=st.integers(0, 5))
    def answer(self, yes: bool, rest: bool, stale: int) -> None:
        option = self.taught
        asking = option is not None and not self.path and len(option.answers) < len(FEATURES)
        number = self.answered[self.who] + 1
        if option is not None and self.phase is Phase.CHECKING and stale != 5:
            demo = self.ask(AnswerQuestion(number, yes), OK).demonstration
            assert demo is not None
            assert (demo.kind, demo.states, demo.right) == (Kind.JUDGED, (ASKED,), yes)
            version = frozenset(option.shown)
            option.judged[demo.uuid] = Judged(yes, False, version, ASKED)
            self.answered[self.who] += 1
            self.awaited = demo.uuid
            return
        if option is None or not asking or stale == 5:
            self.ask(AnswerQuestion(number - (stale == 5), yes), RequestStatus.NOT_ASKED)
            return
        for _ in range(len(FEATURES) - len(option.answers) if rest else 1):
            none = len(option.answers) == len(FEATURES) - 1 and not (yes or any(option.answers))
            request = AnswerQuestion(self.answered[self.who] + 1, yes)
            self.ask(request, OK) if not none else self.table.ask(request)
            option.answers = [] if none else [*option.answers, yes]
            self.answered[self.who] += 1

    @rule()
    def go_back(self) -> None:
        option = self.taught
        complete = option is not None and len(option.answers) == len(FEATURES)
        asked = option is not None and (not complete or self.phase is Phase.CHECKING)
        number = self.answered[self.who] + 1 if asked else 0
        can = option is not None and bool(option.answers) and not self.path
        verdict = option is not None and complete and bool(option.verdicts)
        can = can and not (verdict and self.awaited)
        answer = self.ask(
            AnswerQuestion(number, back=True), OK if can else RequestStatus.NOT_ASKED
        )
        if can and verdict and option is not None:
            assert answer.demonstration is not None
            uuid = answer.demonstration.uuid
            assert uuid == next(reversed(option.verdicts))
            self.answered[self.who] += not option.judged.pop(uuid).exam
            option.taken_back.add(uuid)
            self.awaited, self.again = uuid, ''
        elif can and option is not None:
            option.answers.pop()
            self.answered[self.who] += 1

    @rule(start=st.sampled_from(['', '', START, OTHER]), watch=st.booleans())
    def begin(self, start: str, watch: bool) -> None:
        option, phase = self.taught, self.phase
        if option is None or phase not in READY:
            self.ask(BeginDemonstration(start, watch), WRONG)
        elif len(option.shown) >= BUDGET:
            self.ask(BeginDemonstration(start, watch), RequestStatus.BUDGET_SPENT)
        else:
            self.table.began(start, watch=watch)
            self.episode, begun = self.table.episode, self.table.lesson.view.start_state
            again = self.again or option.wrong
            expected = start or again or next(reversed(option.starts), '')
            if not expected:  # the draw depends on nothing else
                key = (self.who, self.name), option.number
                expected = self.drawn.setdefault(key, begun)
            assert begun == expected
            self.path, self.watch, self.exam = [(begun, Source.PERSON)], watch, False

    @precondition(lambda self: self.phase is Phase.EXAM)
    @rule(steps=st.integers(0, 3), right=st.booleans(), stopped=st.booleans())
    def examine(self, steps: int, right: bool, stopped: bool) -> None:
        """Watch a run in the exam, and judge it."""
        self.begin_exam()
        for action in ('north', 'west', 'west')[:steps]:
            self.step(action, True)
        verdict = Verdict.RIGHT if right else Verdict.WRONG
        self.end(verdict, False, False, stopped)
        self.report(True)

    @rule()
    def begin_exam(self) -> None:
        if self.phase is not Phase.EXAM:
            self.ask(BeginDemonstration(exam=True), WRONG)
            return
        self.table.began(exam=True)
        assert self.table.lesson.view.exam
        self.episode = self.table.episode
        self.path, self.watch, self.exam = [(OTHER, Source.PERSON)], True, True

    @precondition(lambda self: self.path)
    @rule(
        action=st.sampled_from(['north', 'south', 'east', 'west']),
        by_machine=st.sampled_from([False, False, True]),
    )
    def step(self, action: str, by_machine: bool) -> None:
        source = MACHINE if by_machine else Source.PERSON
        self.table.drive(action, source=source)
        taken = [each for _, each in self.path[1:]]
        allowed = self.watch and Source.PERSON not in taken if by_machine else not self.exam
        if not allowed:
            self.abandon()
        else:
            assert self.table.here is not None
            self.path.append((self.table.here.state, source))

    def abandon(self) -> None:
        self.again = self.again if self.watch else self.path[0][0]
        self.path = []

    @rule(
        verdict=st.sampled_from(Verdict),
        count=st.booleans(),
        late=st.booleans(),
        stopped=st.booleans(),
    )
    def end(self, verdict: Verdict, count: bool, late: bool, stopped: bool = False) -> None:
        option, steps = self.taught, len(self.path) - 1
        by_machine = sum(source is MACHINE for _, source in self.path)
        request = EndDemonstration(
            verdict, self.episode, max(steps, 0), count_machine_steps=count, stopped=stopped
        )
        judges = verdict in (Verdict.RIGHT, Verdict.WRONG)
        if option is None or not self.path:
            self.ask(request, WRONG)
        elif verdict is Verdict.DISCARD:
            self.ask(request, OK)
            self.abandon()
        elif judges != self.exam:
            self.ask(request, RequestStatus.BAD_VERDICT)
        elif late:
            self.ask(replace(request, step=steps + 1), RequestStatus.NOT_CURRENT)
        elif self.exam and verdict is Verdict.RIGHT and not steps:
            self.ask(request, RequestStatus.NO_STEPS)
        elif self.exam:
            seen = steps - (count and steps > 0 and verdict is Verdict.WRONG)  # the run went on
            demo = self.ask(replace(request, step=seen), OK).demonstration
            states = [state for state, _ in self.path][: seen + 1]
            assert demo is not None
            assert (demo.kind, demo.exam, demo.states) == (Kind.JUDGED, True, tuple(states))
            assert (demo.right, demo.stopped) == (verdict is Verdict.RIGHT, stopped)
            start = states[-1] if stopped else states[0]
            run = Judged(demo.right, True, frozenset(option.shown), start)
            option.judged[demo.uuid] = run
            self.path, self.again, self.awaited = [], '', demo.uuid
        elif verdict is Verdict.DONE and (steps == 0 or (steps == by_machine and not count)):
            self.ask(request, RequestStatus.NO_STEPS)
        elif verdict is Verdict.NOT_HERE and steps > by_machine:
            self.ask(request, RequestStatus.STEPS_TAKEN)
        else:
            demo = self.ask(request, OK).demonstration
            first = 0 if count or verdict is Verdict.NOT_HERE else by_machine
            states = [state for state, _ in self.path[first:]]
            states = states[:1] if verdict is Verdict.NOT_HERE else states
            assert demo is not None
            assert (demo.states, demo.number) == (tuple(states), option.number)
            assert demo.chosen_features == option.chosen
            kept = by_machine if count and verdict is Verdict.DONE else 0
            assert (demo.machine_steps, demo.method) == (kept, option.method or TREES)
            option.number += 1
            option.method = option.method or TREES
            option.shown[demo.uuid] = states[0]
            option.not_here |= {demo.uuid} if verdict is Verdict.NOT_HERE else set()
            if states[0] in option.starts:
                option.starts.remove(states[0])
            self.path, self.again, self.awaited = [], '', demo.uuid

    @precondition(lambda self: self.phase in READY)
    @rule(actions=st.lists(st.sampled_from(['north', 'west']), max_size=3), met=st.booleans())
    def show(self, actions: list[str], met: bool) -> None:
        """Give a whole demonstration that is learned from."""
        self.begin('', False)
        for action in actions if self.path else ():
            self.step(action, False)
        self.end(Verdict.DONE if actions else Verdict.NOT_HERE, False, False)
        self.report(met)

    @rule(met=st.booleans())
    def report(self, met: bool) -> None:
        """Let the learner count everything in and out, and say whether the criteria are met."""
        option, key = self.taught, (self.who, self.name)
        self.reports.pop(key, None)
        if option is not None and option.shown:
            criteria = (Criterion('return', 0.0, 1.0, met),)
            n_not_here = len(option.not_here & option.shown.keys())
            exam = [run.right for run in option.verdicts.values() if run.exam]
            self.reports[key] = (
                OptionSummary(
                    self.name,
                    self.who,
                    option.chosen,
                    option.method or TREES,
                    len(option.shown) - n_not_here,
                    n_not_here,
                    next(reversed(option.shown)),
                    criteria,
                    n_questions=option.n_questions,
                    exam_right=sum(exam),
                    exam_runs=len(exam),
                    exam_needed=EXAM,
                ),
                met,
            )
        self.table.lesson.update_summaries([summary for summary, _ in self.reports.values()])
        newest = next(reversed(option.shown), '') if option is not None else ''
        if option is not None:
            reported = [*option.withdrawn, *option.taken_back, newest]
            if self.awaited in (*reported, *(option.judged if option.shown else ())):
                self.awaited = ''

    @rule(silent=st.booleans())
    def learner_fails(self, silent: bool) -> None:
        if silent:
            self.table.lesson.learner_silent()
        else:
            self.table.lesson.learner_refused(self.awaited or 'another', 'the disk is full')
        self.awaited = ''

    @rule(place=st.integers(0, 4))
    def withdraw(self, place: int) -> None:
        option = self.taught
        uuid = ['', 'unknown', *(option.shown if option is not None else ())][: place + 1][-1]
        if option is None or self.path or self.awaited:
            self.ask(WithdrawDemonstration(uuid), WRONG)
        elif uuid == 'unknown' or not option.shown:
            self.ask(WithdrawDemonstration(uuid), RequestStatus.NO_DEMONSTRATION)
        else:
            answer = self.ask(WithdrawDemonstration(uuid), OK)
            assert answer.uuid == (uuid or next(reversed(option.shown)))
            option.withdrawn[answer.uuid] = option.shown.pop(answer.uuid)
            option.starts.append(option.withdrawn[answer.uuid])
            self.awaited, self.again = answer.uuid, ''

    @rule(name=NAMES, new=st.sampled_from(['', 'go', 'fetch', 'renamed']), now=RARELY)
    def change(self, name: str, new: str, now: bool) -> None:
        if not now:
            return
        old, key = self.options.get((self.who, name)), (self.who, new)
        if self.path or self.awaited:
            self.ask(ChangeOption(name, new), WRONG)
        elif old is None:
            self.ask(ChangeOption(name, new), RequestStatus.NO_OPTION)
        elif key in self.options:
            self.ask(ChangeOption(name, new), RequestStatus.NAME_TAKEN)
        else:
            answer = self.ask(ChangeOption(name, new), OK)
            del self.options[self.who, name]
            gone = [*old.shown, *old.withdrawn, *old.judged, *old.taken_back]
            self.moved |= dict.fromkeys(gone, True)
            self.numbers[self.who, name] = old.number
            self.answered[self.who] += old.n_questions  # they are withdrawn
            assert answer.known_options == tuple(
                n for w, n in (*self.options, *([key] if new else [])) if w == self.who
            )
            if new:
                moved = [demo for demo in answer.unsent if not demo.withdrawn]
                for demo in moved:
                    check_demonstration(demo, TAXI)
                runs = judged(moved)
                moved = shown(moved)
                assert [demo.states[0] for demo in moved] == list(old.shown.values())
                number = self.numbers.get(key, 1)
                fresh = self.options[key] = Taught(number + len(moved), old.method, old.answers)
                fresh.shown = {demo.uuid: demo.states[0] for demo in moved}
                fresh.not_here = {d.uuid for d in moved if d.kind is Kind.NOT_HERE}
                new_version = frozenset(fresh.shown)
                for run, known in zip(runs, old.judged.values(), strict=True):
                    now = known.version == frozenset(old.shown)
                    version = new_version if now else frozenset([run.option_version])
                    fresh.judged[run.uuid] = replace(known, version=version)
                self.answered[self.who] += len(old.answers) + fresh.n_questions
                self.sessions[self.who, self.session] = new
                self.turn_to(new)
                self.awaited = moved[-1].uuid if moved else ''
            elif name == self.name:
                self.turn_to('')

    @rule()
    def restart_game(self) -> None:
        self.table.lesson.game_restarted()
        self.table.episode = 0
        if self.path:
            self.abandon()

    @precondition(lambda self: self.who)
    @rule()
    def restart_lesson(self) -> None:
        """Start the lesson's process again: it goes on where the other one was."""
        self._start_lesson()
        assert self.table.lesson.resume(self.who, self.session).ok
        self.name = self.sessions[self.who, self.session]
        self.name = self.name if self.taught is not None else ''
        self.awaited = ''
        if self.taught is not None:
            self.awaited = ['', *self.taught.shown, *self.taught.verdicts][-1]

    @rule()
    def pause(self) -> None:
        """While it is paused nothing new begins, and then all is as it was."""
        before = self.table.lesson.view
        self.table.lesson.pause('the disk is full')
        for request in (OpenSession('p2'), DefineOption('go'), BeginDemonstration()):
            assert self.table.ask(request).status is RequestStatus.PAUSED
        paused = self.table.lesson.view
        assert (paused.phase, paused.paused) == (before.phase, 'the disk is full')
        self.table.lesson.pause('')
        assert self.table.lesson.view == before

    @property
    def met(self) -> bool:
        """Whether the newest report says that the criteria are met, for what is taught now."""
        report, met = self.reports.get((self.who, self.name), (None, False))
        option = self.taught
        return (
            met
            and report is not None
            and option is not None
            and report.last_uuid in option.shown
            and report.n_demonstrations + report.n_not_here <= len(option.shown)
            and (report.features, report.method) == (option.chosen, option.method or TREES)
        )

    @property
    def phase(self) -> Phase:
        option = self.taught
        if not self.who:
            return Phase.NO_SESSION
        if option is None:
            return Phase.NO_OPTION
        if self.path:
            return Phase.DEMONSTRATING
        if len(option.answers) < len(FEATURES):
            return Phase.ASKING
        if self.awaited:
            return Phase.LEARNING
        if self.met and not option.wrong:
            summary, _ = self.reports[self.who, self.name]
            if summary.exam_passed:
                return Phase.FINISHED
            return Phase.EXAM if option.asked else Phase.CHECKING
        return Phase.FINISHED if len(option.shown) >= BUDGET else Phase.READY

    @invariant()
    def the_view_is_that_of_the_model(self) -> None:
        view, option = self.table.lesson.view, self.taught
        assert (view.phase, view.participant, view.session) == (self.phase, self.who, self.session)
        assert (view.option_name, view.criteria_met) == (self.name, self.met)
        assert view.text
        if option is not None:
            asking = len(option.answers) < len(FEATURES)
            checking = view.phase is Phase.CHECKING
            n_not_here = len(option.not_here & option.shown.keys())
            assert view.n_not_here == n_not_here
            assert view.n_demonstrations == len(option.shown) - n_not_here
            assert view.last_uuid == next(reversed(option.shown), '')
            assert view.chosen_features == option.chosen
            assert view.earlier_features == (option.earlier if asking else ())
            assert view.question_feature == (FEATURES[len(option.answers)] if asking else '')
            open_id = self.answered[self.who] + 1 if asking or checking else 0
            assert view.question_id == open_id
            assert view.question_states == ((ASKED,) if checking else ())
            assert view.method == (option.method or TREES)

    @invariant()
    def no_demonstration_is_lost(self) -> None:
        expected = dict(self.moved)
        for option in self.options.values():
            expected |= dict.fromkeys([*option.shown, *option.judged], False)
            expected |= dict.fromkeys([*option.withdrawn, *option.taken_back], True)
        kept = {demo.uuid: demo.withdrawn for demo in self.table.lesson.demonstrations()}
        assert kept == expected


LessonMachine.TestCase.settings = settings(max_examples=60, stateful_step_count=50, deadline=None)
TestLesson = LessonMachine.TestCase
