"""The course of a study: one participant at a time, one condition at a time."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
import sys
from typing import Any, NamedTuple
from urllib.parse import quote

from humanopts_env.domains.registry import make_domain
from humanopts_env.seeding import generator
from humanopts_learner.summary import OptionSummary
from humanopts_ros.limits import one_line
from humanopts_teach.command_line import LaunchOptions
from humanopts_teach.commands.session import (
    ARRIVAL_SECONDS,
    known_code,
    new_name,
    place,
    run_in_terminal,
    Session,
    session,
    setup_from,
    taught_options,
    wait_until_taught,
    WATCHED,
)
from humanopts_teach.dialogue.consent import ConsentApp
from humanopts_teach.language import _, N_, speaking
from humanopts_teach.launching.processes import Setup
from humanopts_teach.ros.teleop import published_record
from humanopts_teach.study.events import learned, TIME
from humanopts_teach.study.log import LogEvent
from humanopts_teach.study.plan import Condition, Part, PartKind, PARTS, StudyPlan
from humanopts_teach.study.questions import QuestionKind
from humanopts_teach.study.record import (
    ChangedPlanError,
    FullError,
    OpenRecord,
    Record,
    StudyError,
    StudyFolder,
    TOPIC,
)
from humanopts_teach.terminal.show import show

_MIN_SECONDS = 1.0  # minimum remaining time of a part that can be continued
_CANNOT_BEGIN = N_(
    'The study cannot begin right now, and nothing was saved. Please tell the person who invited '
    'you.'
)
_ERROR_RATE = 0.02  # share of a simulated participant's steps that are wrong


@dataclass(frozen=True)
class Turn:
    """The activity of a participant in one condition."""

    condition: Condition
    left: Sequence[Part]
    setup: Setup


class Farewell(NamedTuple):
    """
    The end of a participant's visit.

    :ivar text: text shown to the participant.
    :ivar url: URL of the recruiting platform, from the plan; empty: none.
    """

    text: str
    url: str = ''

    @property
    def in_terminal(self) -> str:
        """The text, with the URL on a separate line."""
        return '\n'.join(filter(None, self))


def _address(template: str | None, code: str) -> str:
    return (template or '').replace('{code}', quote(code, safe=''))


@dataclass(frozen=True)
class Study:
    """The plan for new participants, and the folder of all participants."""

    plan: StudyPlan
    folder: StudyFolder
    namespace: str

    def check_plan(self, *, accept: bool) -> None:
        """
        Compare the plan with the stored one, and print the differences.

        :param accept: whether to store a changed plan.
        :raises ChangedPlanError: the plan was changed, and ``accept`` is False.
        :raises StudyError: the stored plan is damaged.
        """
        try:
            self.folder.check(self.plan)
        except ChangedPlanError as error:
            for line in error.diff:
                print(one_line(line), file=sys.stderr)
            if not accept:
                raise
            self.folder.accept(self.plan)
            print('The changed plan is kept; participants who have begun keep theirs.')

    def run(self, code: str) -> int:
        """Take a person through the consent and all remaining conditions in this terminal."""
        with place(self.namespace), speaking(self.plan.language):
            self.warn()
            code, status, seconds = known_code(code, self.folder.codes()), 0, None
            if (consent := self.consent_app(code)) is not None:
                show(consent)
                if consent.agreed is None:
                    print(_('Nothing was saved.'))
                elif not consent.agreed:
                    print(self.declined().in_terminal)
                if not consent.agreed:
                    return 0
                seconds = consent.seconds
            with self.enter(code, consent_seconds=seconds) as participant:
                turn = self.next_turn(participant)
                while isinstance(turn, Turn):
                    status = run_in_terminal(turn.setup)
                    turn = self.next_turn(participant, turn)
                print(turn.in_terminal)
        return status

    def simulate(self, code: str) -> None:
        """Let a simulated teacher take part; the seed determines its answers."""
        with place(self.namespace), self.enter(code, simulated=True) as participant:
            turn = self.next_turn(participant, simulated=True)
            while isinstance(turn, Turn):
                print(f'{code}: {turn.condition.name}', flush=True)
                with session(turn.setup) as running:

                    def teach(running: Session = running) -> list[OptionSummary]:
                        wait_until_taught(running)
                        return [summary for _, summary in running.graph.learned()]

                    record = published_record(running.graph, participant.path, code)
                    recorded = running.graph.is_fully_recorded
                    running.graph.wait(recorded, ARRIVAL_SECONDS, f'{TOPIC} to be recorded')
                    seed = self.folder.plan_of(self.plan, participant).seed
                    for part in turn.left:
                        simulated_part(part, record, seed, participant.number, teach)
                turn = self.next_turn(participant, turn, simulated=True)

    def warn(self) -> None:
        """Print warnings about omitted records and lines."""
        for problem in self.folder.records()[1]:
            print(one_line(f'humanopts study: {problem}'), file=sys.stderr)

    def consent_app(self, code: str) -> ConsentApp | None:
        """
        Return the consent to show before anything runs or is written; None: not required.

        People who arrive when all places are taken are counted.

        :raises StudyError: the code cannot take part.
        """
        try:
            known = self.folder.find(self.plan, code)
        except FullError:
            self._count(code, 'full')
            raise
        pages = self.plan.consent_parts
        if known is not None:
            pages = known.remaining(self.folder.plan_of(self.plan, known).consent_parts)
        if not pages:
            return None
        app = ConsentApp(pages, partial(self._count, code, 'declined'))
        app.language = self.plan.language
        return app

    def declined(self) -> Farewell:
        """Return the text shown to a person who has declined."""
        text = _('Nothing was saved. Only the number of people who decline is counted.')
        return Farewell(text, _address(self.plan.recruiting.declined, ''))

    def _count(self, code: str, event: LogEvent | None) -> None:
        """Count a person once; report an error only to the researcher."""
        try:
            self.folder.count(code, event)
        except OSError as error:
            text = f'humanopts study: the number of people in the log is wrong by one: {error}'
            print(one_line(text), file=sys.stderr, flush=True)

    @contextmanager
    def enter(
        self,
        code: str,
        *,
        simulated: bool = False,
        consent_seconds: float | None = None,
        **client: Any,
    ) -> Iterator[Record]:
        """
        Start a visit: yield the record of a participant, locked until the context ends.

        :param consent_seconds: time that the person took to consent, s; None: not requested.
        :param client: fields of the 'client' event: browser, width, height, language, columns.
        :raises StudyError: the code cannot take part, takes part elsewhere, or is new and cannot
            be written; in the last case, no data of the participant remain.
        :raises OSError: the record of a returning participant cannot be written.
        """
        try:
            record = self.folder.enter(
                self.plan, code, simulated=simulated, consent_seconds=consent_seconds, **client
            )
        except OSError as error:
            if code in self.folder.codes():
                raise
            text = f'humanopts study: {code} could not begin, and nothing was saved: {error}'
            print(one_line(text), file=sys.stderr, flush=True)
            raise StudyError(_CANNOT_BEGIN) from error
        self._count(code, None)
        with self.folder.hold(record):
            yield record

    def farewell(self, record: Record) -> Farewell:
        """Return the text shown to a participant at the end of the visit."""
        record, recruiting = record.read(), self.plan.recruiting
        if record.excluded:
            text = _('The study ends here: too many attention checks were failed.')
            return Farewell(text, _address(recruiting.failed, record.code))
        if not record.over:
            text = _('You have not finished yet. Continue with the same code: {code}')
            return Farewell(text.format(code=record.code))
        text, completed = _('You have finished the study. Thank you.'), recruiting.completed or ''
        if completed and not completed.startswith('https:'):
            text += ' ' + _('Your completion code: {code}').format(code=completed)
            completed = ''
        return Farewell(text, _address(completed, record.code))

    def next_turn(
        self, participant: Record, last: Turn | None = None, *, simulated: bool = False
    ) -> Turn | Farewell:
        """
        Return the next condition with remaining parts, or a farewell if there is none.

        :param last: condition that just ended.
        :raises CommandError: the next condition cannot be launched.
        :raises StudyError: the record or its plan cannot be used.
        """
        record, notes = participant.read(), OpenRecord(participant.path)
        if record.excluded:
            notes.note('ended')
            return self.farewell(record)
        if last is not None and record.remaining(last.left):
            return self.farewell(record)
        plan = self.folder.plan_of(self.plan, participant)
        turns = plan.turns_of(record.place, record.number)
        for part in record.remaining(plan.parts_of(record.place, record.number)):
            spent = record.seconds_in(part.key)
            if part.minutes and spent > max(0.0, 60 * part.minutes - _MIN_SECONDS):
                notes.note('part ended', part, why=TIME)
        record = participant.read()
        for condition, parts in turns:
            if left := record.remaining(parts):
                setup = self._setup(plan, participant, condition, left, simulated=simulated)
                return Turn(condition, left, setup)
        notes.note('ended')
        return self.farewell(record)

    def _setup(
        self,
        plan: StudyPlan,
        participant: Record,
        condition: Condition,
        left: Sequence[Part],
        *,
        simulated: bool,
    ) -> Setup:
        """
        Return the launch setup of a condition.

        :param left: remaining parts.
        :param simulated: whether the participant is simulated.
        """
        launch = LaunchOptions(
            out=self.folder.path / participant.code / condition.name,
            seed=plan.seed + participant.number,
            strategy=condition.strategy,  # type: ignore[arg-type]  # the plan was checked
            learn=condition.learn,  # type: ignore[arg-type]
            budget=condition.budget,
            unstick=condition.unstick,
            derive=[*condition.derive],
            parameter=[*condition.parameters.items()],
            namespace=self.namespace,
        )
        own: dict[str, Any] = {
            'keyboard': True,
            'pictures': condition.picture,
            'step_period': WATCHED,
            'language': plan.language,
        }
        if simulated:
            domain = make_domain(condition.domain, dict(condition.parameters))
            teaches = any(part.kind is PartKind.TEACH for part in left)
            taught = condition.teach_buttons or taught_options(domain)
            own = {'taught': taught if teaches else (), 'teacher_error_rate': _ERROR_RATE}
        return setup_from(
            condition.domain,
            launch,
            bag_name=new_name('bags/study'),
            participant=participant.code,
            ask_participant=False,
            study=plan.study,
            condition=condition.name,
            study_parts=PARTS.dump_json(tuple(left)).decode(),
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

    Buttons are suggested with the frequencies of Table 1 of the paper; answers are uniform, and
    attention checks are passed.

    :param seed: seed of the study.
    :param number: index of the participant in order of arrival.
    :param teach: function that runs a simulated teacher and returns the learned options.
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
            value = question.draw(rng, points)
            scale = {'points': points} if question.kind is QuestionKind.RATING else {}
            record.note('answer', part, item=question.name, value=value, **scale)
    record.note('part ended', part, why=record.check_attention(part))
