"""A study as it is carried out: one participant after the other, condition by condition."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
import sys
from typing import Any

from humanopts_env.domains.registry import make_domain
from humanopts_env.seeding import generator
from humanopts_learner.ros.convert import summary_from_message
from humanopts_learner.summary import OptionSummary
from humanopts_ros.limits import one_line
from humanopts_teach.command_line import LaunchOptions
from humanopts_teach.commands import agreed, CommandError, refusing
from humanopts_teach.commands.session import (
    new_name,
    NEWS_SECONDS,
    place,
    run_in_terminal,
    Session,
    session,
    setup_from,
    taught_options,
    wait_until_taught,
    WATCHED,
)
from humanopts_teach.launching.processes import Setup
from humanopts_teach.lesson.store import similar_code
from humanopts_teach.ros.teleop import published_record
from humanopts_teach.study.events import EventKind, FINISHED, learned, REFUSED, TIME
from humanopts_teach.study.plan import Condition, Part, PartKind, PARTS, StudyPlan
from humanopts_teach.study.record import (
    ChangedPlanError,
    OpenRecord,
    Record,
    SimilarCodeError,
    StudyError,
    StudyFolder,
    TOPIC,
)

_LEAST_SECONDS = 1.0  # that a part needs left to be taken up again
_ERROR_RATE = 0.02  # share of a simulated participant's steps that are wrong


@dataclass(frozen=True)
class Turn:
    """What a participant does in one condition."""

    condition: Condition
    left: Sequence[Part]
    setup: Setup


@dataclass(frozen=True)
class Study:
    """A plan, for those who begin, and the folder of those who take part."""

    plan: StudyPlan
    folder: StudyFolder
    namespace: str

    def check_plan(self, *, accept: bool) -> None:
        """
        Compare the plan with the one that is kept, and print the difference.

        :param accept: keep it, if it has been changed.
        :raises CommandError: it has been changed and is not accepted, or the folder cannot be
            read or written.
        """
        try:
            with refusing(OSError):
                self.folder.check(self.plan)
        except ChangedPlanError as error:
            for line in error.diff:
                print(one_line(line), file=sys.stderr)
            if not accept:
                raise CommandError(str(error)) from error
            with refusing(StudyError), refusing(OSError, what='the change cannot be kept: '):
                self.folder.accept(self.plan)
            print('The changed plan is kept; participants who have begun keep theirs.')
        except StudyError as error:
            raise CommandError(str(error)) from error

    def plan_of(self, participant: Record) -> StudyPlan:
        """
        Return the plan that a participant follows.

        :raises CommandError: it cannot be read.
        """
        with (
            refusing(StudyError),
            refusing(OSError, what=f'cannot read the plan of {participant.code}: '),
        ):
            return self.folder.plan_of(self.plan, participant)

    def run(self, code: str) -> int:
        """Take a person through all conditions that are left, in this terminal."""
        with place(self.namespace):
            self.warn()
            participant = self.enter(self.settled(code))
            while (turn := self.next_turn(participant)) is not None:
                status = run_in_terminal(turn.setup)
                if left := self.farewell(participant, turn):
                    print(left)
                    return status
            print(self.finish(participant))
        return 0

    def simulate(self, code: str) -> None:
        """Let a simulated teacher take part, whose other answers are drawn by the seed."""
        with place(self.namespace):
            participant = self.enter(code, simulated=True)
            while (turn := self.next_turn(participant, simulated=True)) is not None:
                print(f'{code}: {turn.condition.name}', flush=True)
                with session(turn.setup) as running:

                    def teach(running: Session = running) -> list[OptionSummary]:
                        wait_until_taught(running)
                        return [summary_from_message(each) for _, each in running.graph.learned()]

                    record = published_record(running.graph, participant.path, code)
                    recorded = running.graph.is_recorded_whole
                    running.graph.wait(recorded, NEWS_SECONDS, f'{TOPIC} to be recorded')
                    for part in turn.left:
                        seed = self.plan_of(participant).seed
                        simulated_part(part, record, seed, participant.number, teach)
            self.finish(participant)

    def settled(self, code: str) -> str:
        """
        Return the code of a person, whom this terminal asks where another differs only in case.

        :raises CommandError: the person is another one, and needs another code.
        """
        similar = similar_code(code, self.folder.codes())
        if similar and not agreed(f'{similar} has taken part. Go on as {similar}?'):
            raise CommandError(str(SimilarCodeError(code, similar)))
        return similar or code

    def warn(self) -> None:
        """Print what is left out of the records."""
        for problem in self.folder.records()[1]:
            print(one_line(f'humanopts study: {problem}'), file=sys.stderr)

    def enter(self, code: str, *, simulated: bool = False) -> Record:
        """
        Return who takes part.

        :raises CommandError: nobody can with this code, or the folder cannot be written.
        """
        with refusing(StudyError), refusing(OSError, what=f'cannot write in {self.folder.path}: '):
            return self.folder.enter(self.plan, code, simulated=simulated)

    def next_turn(self, participant: Record, *, simulated: bool = False) -> Turn | None:
        """
        Return the next condition of which a participant has parts left; None: there is none.

        :raises CommandError: it cannot be launched.
        """
        plan = self.plan_of(participant)
        turns = plan.turns_of(participant.number)
        record = self._record(participant)
        for part in record.left_of([part for _, parts in turns for part in parts]):
            spent = record.seconds_in(part.key)
            if part.minutes and spent > max(0.0, 60 * part.minutes - _LEAST_SECONDS):
                self._note(participant, 'part ended', part, why=TIME)
        record = self._record(participant)
        for condition, parts in turns:
            if left := record.left_of(parts):
                setup = self._setup(plan, participant, condition, None if simulated else left)
                return Turn(condition, left, setup)
        return None

    def farewell(self, participant: Record, turn: Turn) -> str:
        """
        Return why a participant does not go on after a turn; empty: the next one follows.

        :raises CommandError: the record cannot be read or written.
        """
        record = self._record(participant)
        if record.refused:
            self._note(participant, 'ended', why=REFUSED)
            return f'{participant.code} does not take part; nothing more is asked'
        if record.left_of(turn.left):
            return f'{participant.code} has not finished; the same code goes on'
        return ''

    def finish(self, participant: Record) -> str:
        """
        Note that a participant has finished, and return it in words.

        :raises CommandError: the record cannot be written.
        """
        self._note(participant, 'ended')
        return f'{participant.code} has finished; everything is in {self.folder.path}'

    def _record(self, participant: Record) -> Record:
        with refusing(StudyError), refusing(OSError, what=f'cannot read {participant.path}: '):
            return participant.read()

    def _note(
        self, participant: Record, kind: EventKind, part: Part | None = None, **values: Any
    ) -> None:
        with refusing(StudyError), refusing(OSError, what=f'cannot write {participant.path}: '):
            OpenRecord(participant.path).note(kind, part, **values)

    def _setup(
        self,
        plan: StudyPlan,
        participant: Record,
        condition: Condition,
        left: Sequence[Part] | None = None,
    ) -> Setup:
        """
        Return the launch of a condition.

        :param left: parts that a person has to do; None: a simulated teacher takes part.
        """
        launch = LaunchOptions(
            out=self.folder.path / participant.code / condition.name,
            seed=plan.seed + participant.number,
            strategy=condition.strategy,  # type: ignore[arg-type]  # the plan was checked
            learn=condition.learn,  # type: ignore[arg-type]
            budget=condition.budget,
            parameter=[*condition.parameters.items()],
            namespace=self.namespace,
        )
        own: dict[str, Any] = {'taught': (), 'keyboard': True, 'step_period': WATCHED}
        if left is None:
            domain = make_domain(condition.domain, dict(condition.parameters))
            own = {'taught': taught_options(domain), 'teacher_error_rate': _ERROR_RATE}
        parts = PARTS.dump_json(tuple(left or ())).decode()
        return setup_from(
            condition.domain,
            launch,
            bag_name=new_name('bags/study'),
            participant=participant.code,
            ask_participant=False,
            study=plan.study,
            condition=condition.name,
            study_parts=parts,
            study_record=str(participant.path.absolute()),
            **own,
        )


def simulated_part(
    part: Part,
    record: OpenRecord,
    seed: int,
    number: int,
    teach: Callable[[], Iterable[OptionSummary]],
) -> None:
    """
    Do one part of a study.

    Buttons are suggested with the frequencies of Table 1 of the paper; ratings are drawn evenly.

    :param seed: of the study.
    :param number: of the participant.
    :param teach: has a simulated teacher teach, and returns what was learned.
    """
    from humanopts_teach.evaluation.table1 import TABLE_1  # slow to import

    rng = generator(seed, 'simulated participant', number, part.key)
    record.note('part began', part)
    if part.kind is PartKind.TEACH:
        record.note('learned', part, options=learned(teach()))
    elif part.kind is PartKind.BUTTONS:
        shares = TABLE_1.get(part.domain, {})
        named = [name for name, share in shares.items() if rng.random() < share]
        for rank, text in enumerate(named[: part.most], start=1):
            record.note('button', part, domain=part.domain, rank=rank, text=text)
    elif part.questions is not None:
        points = part.questions.points
        for question in part.questions.items:
            value = int(rng.integers(1, points + 1))
            record.note('answer', part, item=question.name, value=value, points=points)
    record.note('part ended', part, why=FINISHED)
