"""
A lesson in one process: a simulated teacher, the lesson, the game and the learner, without ROS.

It is made of the parts that the nodes are made of and asks them in the same order, so the same
settings and seed give the same demonstrations as a lesson over the graph.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
import tempfile
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.game import Accepted, Command, Game, Source, Transition
from humanopts_learner.demonstrations import Demonstration, Kind
from humanopts_learner.options.criteria import judge, Thresholds
from humanopts_learner.options.files import option_to_json
from humanopts_learner.options.learn import learn_option
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.summary import Criterion, OptionSummary
from humanopts_teach.lesson.lesson import Lesson
from humanopts_teach.lesson.requests import (
    Answer,
    AnswerQuestion,
    BeginDemonstration,
    DefineOption,
    Drive,
    EndDemonstration,
)
from humanopts_teach.lesson.seeded_starts import LessonRules, SeededStarts
from humanopts_teach.lesson.simulated_teacher import (
    Act,
    Finish,
    SimulatedTeacher,
    TeacherError,
    TeacherSettings,
    Wait,
)
from humanopts_teach.lesson.store import DemonstrationStore

# What a person is taken to need for one act, s: a simulated one needs no time of its own.
SECONDS = {
    DefineOption: 5.0,
    AnswerQuestion: 3.0,
    BeginDemonstration: 2.0,
    Drive: 0.5,
    EndDemonstration: 1.0,
}

# Return whether an option is taught well enough; called after each of its demonstrations, with all
# of them, from the first trajectory on.
Enough = Callable[[Sequence[Demonstration], LearnedOption], bool]


class LessonError(RuntimeError):
    """The lesson cannot go on; the text says why."""


@dataclass(frozen=True)
class Taught:
    """The results of a lesson."""

    demonstrations: tuple[Demonstration, ...]  # of all options, in order
    options: tuple[LearnedOption, ...]  # the last of each option
    seconds: float  # that a person would have needed, by ``SECONDS``
    cut_short: str  # why the teacher gave up, in words; empty: it taught everything


def teach(
    domain: Domain[Any],
    teacher: TeacherSettings,
    rules: LessonRules | None = None,
    enough: Enough | None = None,
) -> Taught:
    """
    Have a simulated teacher teach options, one after another.

    :param rules: of the lesson; its seed is the learner's too. None: the defaults.
    :param enough: None: all criteria that can be measured hold, with the usual thresholds.
    :raises TeacherError: there is no such option to teach, or a setting is wrong.
    :raises LessonError: an act of the teacher was refused.
    """
    rules = rules or LessonRules()
    seed = rules.seed

    def settled(shown: Sequence[Demonstration], option: LearnedOption) -> bool:
        return judge(shown, domain, Thresholds(), seed, option).settled

    with (
        tempfile.TemporaryDirectory(prefix='humanopts-') as folder,
        DemonstrationStore(Path(folder)) as store,
    ):
        return _InProcess(domain, teacher, rules, enough or settled, store).run()


class _InProcess:
    """The parts of one lesson, and the clock of the person who is simulated."""

    def __init__(
        self,
        domain: Domain[Any],
        teacher: TeacherSettings,
        rules: LessonRules,
        enough: Enough,
        store: DemonstrationStore,
    ) -> None:
        self._domain, self._seed, self._enough = domain, rules.seed, enough
        self._seconds = 0.0
        self._teacher = SimulatedTeacher(domain, teacher)
        starts = SeededStarts(domain, rules)
        self._lesson = Lesson(domain, store, starts, clock=lambda: self._seconds, today=lambda: '')
        self._game = Game(domain)
        self._transition: Transition | None = None
        self._options: dict[str, LearnedOption] = {}
        self._summaries: dict[str, OptionSummary] = {}  # by option

    def run(self) -> Taught:
        """Do what the teacher does next, until it is done or gives up."""
        cut_short = ''
        try:
            while not isinstance(
                act := self._teacher.next_act(self._lesson.view, self._transition), Finish
            ):
                self._do(act)
        except TeacherError as error:
            cut_short = str(error)
        demonstrations = tuple(self._lesson.demonstrations())
        return Taught(demonstrations, tuple(self._options.values()), self._seconds, cut_short)

    def _do(self, act: Act) -> None:
        self._seconds += SECONDS.get(type(act), 0.0)
        match act:
            case Wait() | Finish():
                raise LessonError(f'the teacher waits for {act}, and nothing is under way')
            case Drive():
                self._drive(act)
            case _:
                answer = self._lesson.carry_out(act)
                if not answer.carried_out:
                    raise LessonError(answer.detail)
                if isinstance(act, BeginDemonstration):
                    self._begin(answer)
                if answer.demonstration is not None:
                    self._learn(answer.demonstration)

    def _begin(self, prepared: Answer) -> None:
        transition = self._game.reset(prepared.state, prepared.seed, Source.PERSON).transition
        if transition is None:
            raise LessonError(f'the game does not begin in {prepared.state}')
        self._lesson.began(transition.episode, transition.state)
        self._see(transition)

    def _drive(self, act: Drive) -> None:
        command = Command('teacher', 0, Source.PERSON, act.episode, act.step, act.action)
        reply = self._game.command(command)
        if not isinstance(reply, Accepted):
            raise LessonError(f'the game refused {act.action}: {reply.detail}')
        self._see(reply.transition)

    def _see(self, transition: Transition) -> None:
        self._transition = transition
        self._lesson.add_transition(transition)

    def _learn(self, newest: Demonstration) -> None:
        """Learn the option again as the learner does, and report to the lesson."""
        name, enough = newest.option_name, False
        shown = [d for d in self._lesson.demonstrations() if d.option_name == name]
        features = newest.chosen_features
        if any(demo.kind is Kind.TRAJECTORY for demo in shown):
            option = self._options[name] = learn_option(shown, self._domain, self._seed)
            features = option.features
            self._lesson.update_option(newest.participant, name, option_to_json(option, []))
            enough = self._enough(shown, option)
        self._summaries[name] = OptionSummary(
            name,
            newest.participant,
            features,
            last_uuid=newest.uuid,
            method=newest.method,
            criteria=(Criterion('enough', None, None, met=enough),),
        )
        self._lesson.update_summaries(list(self._summaries.values()))
