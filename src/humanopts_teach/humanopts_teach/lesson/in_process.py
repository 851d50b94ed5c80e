"""
A lesson in one process: a simulated teacher, the lesson, the game and the learner, without ROS.

It uses the same components as the nodes, in the same order, so the same settings and seed give the
same demonstrations as a lesson over the graph.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
import tempfile

from humanopts_env.domains.base import Domain
from humanopts_env.domains.reference import ReferenceOption
from humanopts_env.game import Accepted, Command, Game, Source, Transition
from humanopts_learner.demonstrations import Demonstration, Kind
from humanopts_learner.options.files import option_to_json
from humanopts_learner.options.judge import judge, Thresholds
from humanopts_learner.options.learn import learn_option
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_learner.planning.request import HUMAN, PlanRequest
from humanopts_learner.planning.sampled_plan import make_sampled_plan
from humanopts_learner.planning.stuck import try_plan
from humanopts_learner.summary import Criterion, OptionSummary
from humanopts_teach.lesson.lesson import Lesson
from humanopts_teach.lesson.requests import (
    AnswerQuestion,
    BeginDemonstration,
    DefineOption,
    Drive,
    EndDemonstration,
)
from humanopts_teach.lesson.seeded_starts import LessonRules, SeededStarts
from humanopts_teach.lesson.simulated_teacher import (
    Finish,
    SimulatedTeacher,
    TeacherError,
    TeacherSettings,
    Wait,
)
from humanopts_teach.lesson.store import DemonstrationStore

# Assumed duration of a person's actions, s; a simulated teacher takes no time.
SECONDS = {
    DefineOption: 5.0,
    AnswerQuestion: 3.0,
    BeginDemonstration: 2.0,
    Drive: 0.5,
    EndDemonstration: 1.0,
}

# Returns whether an option is taught well enough; called with all of its demonstrations after each
# new one, from the first trajectory on.
Enough = Callable[[Sequence[Demonstration], LearnedOption], bool]


class LessonError(RuntimeError):
    """The lesson cannot continue; the message says why."""


@dataclass(frozen=True)
class Taught:
    """The results of a lesson."""

    demonstrations: tuple[Demonstration, ...]  # of all options, in order
    options: tuple[LearnedOption, ...]  # final version of each option
    seconds: float  # estimated duration for a person, by ``SECONDS``
    cut_short: str  # why the teacher gave up; empty: everything was taught
    acts: Counter[type]  # the person's actions, by type


def teach(
    domain: Domain,
    teacher: TeacherSettings,
    rules: LessonRules | None = None,
    enough: Enough | None = None,
    where_stuck: int = 0,
    references: Mapping[str, ReferenceOption] | None = None,
) -> Taught:
    """
    Let a simulated teacher teach options, one after another.

    :param rules: rules of the lesson; the learner uses the same seed. None: the defaults.
    :param enough: end of each option; None: all measurable criteria hold at default thresholds.
    :param where_stuck: maximum number of final demonstrations where a plan gets stuck; a plan is
        made before each of them.
    :param references: what the teacher means by each option; None: the domain's.
    :raises TeacherError: an option does not exist, or a setting is invalid.
    :raises LessonError: an action of the teacher was refused.
    """
    rules = rules or LessonRules()
    seconds, cut_short, tried, shown_there = 0.0, '', False, 0
    acts: Counter[type] = Counter()
    teacher = replace(teacher, where_stuck=bool(where_stuck))
    game, person = Game(domain), SimulatedTeacher(domain, teacher, references)
    newest = Transition()
    options: dict[str, LearnedOption] = {}
    summaries: dict[str, OptionSummary] = {}  # by option

    def learn(demo: Demonstration) -> None:
        """Relearn the option like the learner, and report to the lesson."""
        name, met, features = demo.option_name, False, demo.chosen_features
        shown = [each for each in lesson.demonstrations() if each.option_name == name]
        if any(each.kind is Kind.TRAJECTORY for each in shown):
            option = options[name] = learn_option(shown, domain, rules.seed)
            features = option.features
            lesson.update_option(demo.participant, name, option_to_json(option, []))
            if enough is not None:
                met = enough(shown, option)
            else:
                met = judge(shown, domain, Thresholds(), rules.seed, option).settled
        summaries[name] = OptionSummary(
            name,
            demo.participant,
            features,
            last_uuid=demo.uuid,
            method=demo.method,
            criteria=(Criterion('enough', None, None, met=met),),
        )
        lesson.update_summaries(list(summaries.values()))

    def plan() -> None:
        """Plan with the options, and offer the states in which the plan gets stuck."""
        request = PlanRequest(HUMAN, seed=rules.seed)
        made = make_sampled_plan(domain, list(options.values()), request)
        trial = try_plan(made, rules.seed)
        stuck = zip(trial.options, trial.states)
        lesson.feedback.update_trial(teacher.participant, trial.games, stuck)

    with (
        tempfile.TemporaryDirectory(prefix='humanopts-') as folder,
        DemonstrationStore(Path(folder)) as store,
    ):
        starts = SeededStarts(domain, rules)
        lesson = Lesson(domain, store, starts, clock=lambda: seconds, today=lambda: '')
        while True:
            try:
                act = person.next_act(lesson.view, newest)
            except TeacherError as error:
                cut_short = str(error)
                break
            seconds += SECONDS.get(type(act), 0.0)
            acts[type(act)] += 1
            if isinstance(act, Finish):
                if tried or not where_stuck:
                    break
                tried = True
                plan()
                continue
            if isinstance(act, Wait):
                raise LessonError(f'the teacher waits for {act}, and nothing is under way')
            if isinstance(act, Drive):
                command = Command('teacher', 0, Source.PERSON, act.episode, act.step, act.action)
                reply = game.command(command)
                if not isinstance(reply, Accepted):
                    raise LessonError(f'the game refused {act.action}: {reply.detail}')
                newest = reply.transition
                lesson.add_transition(newest)
                continue
            answer = lesson.carry_out(act)
            if not answer.carried_out:
                raise LessonError(answer.detail)
            if isinstance(act, BeginDemonstration):
                begun = game.reset(answer.state, answer.seed, Source.PERSON).transition
                if begun is None:
                    raise LessonError(f'the game does not begin in {answer.state}')
                newest = begun
                lesson.began(newest.episode, newest.state)
                lesson.add_transition(newest)
            if answer.demonstration is not None:
                learn(answer.demonstration)
                shown_there += tried
                if tried and shown_there < where_stuck:
                    plan()
                elif tried:
                    break
        demonstrations = tuple(lesson.demonstrations())
    return Taught(demonstrations, tuple(options.values()), seconds, cut_short, acts)
