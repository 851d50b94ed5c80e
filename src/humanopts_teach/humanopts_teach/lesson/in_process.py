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
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import Demonstration, judged, Kind, shown
from humanopts_learner.options.exam import with_verdicts
from humanopts_learner.options.files import option_to_json
from humanopts_learner.options.judge import judge, taught_before, Thresholds
from humanopts_learner.options.learn import learn_option
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_learner.planning.request import HUMAN, PlanRequest
from humanopts_learner.planning.sampled_plan import make_sampled_plan
from humanopts_learner.planning.stuck import try_plan
from humanopts_learner.run import Run
from humanopts_learner.summary import Criterion, OptionSummary, unmeasured
from humanopts_teach.lesson.lesson import Lesson
from humanopts_teach.lesson.requests import (
    AnswerQuestion,
    BeginDemonstration,
    DefineOption,
    Drive,
    EndDemonstration,
    LessonView,
    RunOption,
)
from humanopts_teach.lesson.seeded_starts import LessonRules, SeededStarts
from humanopts_teach.lesson.simulated_teacher import (
    Act,
    Finish,
    SimulatedTeacher,
    TeacherError,
    TeacherSettings,
    Wait,
    Watch,
)
from humanopts_teach.lesson.store import DemonstrationStore

# Assumed durations of a person's actions, s, since a simulated teacher takes no time.
SECONDS = {
    DefineOption: 5.0,
    AnswerQuestion: 3.0,
    BeginDemonstration: 2.0,
    Drive: 0.5,
    Watch: 0.25,
    EndDemonstration: 1.0,
}

# Returns whether an option is taught well enough. Called with all of its demonstrations after each
# new one, starting with the first trajectory.
Enough = Callable[[Sequence[Demonstration], LearnedOption], bool]

Watcher = Callable[[LessonView, Transition, Sequence[OptionSummary], Act], object]


class LessonError(RuntimeError):
    """The lesson cannot continue; the message says why."""


@dataclass(frozen=True)
class Taught:
    """The results of a lesson."""

    demonstrations: tuple[Demonstration, ...]  # of all options, in order
    options: tuple[LearnedOption, ...]  # final version of each option
    summaries: tuple[OptionSummary, ...]  # of these options
    judged: tuple[Demonstration, ...]  # runs judged in exams and questions
    seconds: float  # estimated duration for a person, by ``SECONDS``
    cut_short: str  # why the teacher gave up; empty: everything was taught
    acts: Counter[type]  # number of the teacher's acts, by type


def teach(
    domain: Domain,
    teacher: TeacherSettings,
    rules: LessonRules | None = None,
    enough: Enough | None = None,
    where_stuck: int = 0,
    references: Mapping[str, ReferenceOption] | None = None,
    thresholds: Thresholds | None = None,
    watch: Watcher = lambda lesson, game, summaries, act: None,
) -> Taught:
    """
    Let a simulated teacher teach options, one after another.

    :param rules: rules of the lesson; the learner uses the same seed. None: the defaults.
    :param enough: test that ends the lesson on each option; None: criteria, questions and exam.
    :param where_stuck: maximum number of final demonstrations in states where a plan gets stuck;
        each is preceded by a new plan.
    :param references: reference options by name; None: the domain's.
    :param thresholds: thresholds of the criteria and the exam; None: the defaults.
    :param watch: callback before each act, with the state in which the teacher decides on it.
    :raises TeacherError: an option does not exist, or a setting is invalid.
    :raises LessonError: an action of the teacher was refused.
    """
    thresholds = thresholds or Thresholds()
    rules = replace(rules or LessonRules(), ask_about_runs=enough is None)
    seconds, cut_short, tried, shown_there = 0.0, '', False, 0
    acts: Counter[type] = Counter()
    teacher = replace(teacher, where_stuck=bool(where_stuck))
    game, person = Game(domain), SimulatedTeacher(domain, teacher, references)
    newest = Transition()
    options: dict[str, LearnedOption] = {}
    summaries: dict[str, OptionSummary] = {}  # by option

    def learn(demo: Demonstration) -> None:
        """Relearn or judge the option like the learner node, and report to the lesson."""
        name = demo.option_name
        demos = [each for each in lesson.demonstrations() if each.option_name == name]
        summary = unmeasured(demos)
        if any(each.kind is Kind.TRAJECTORY for each in demos):
            if demo.kind is not Kind.JUDGED:
                options[name] = learn_option(demos, domain, rules.seed)
                text = option_to_json(options[name], [])
                lesson.update_option(demo.participant, name, text)
            if enough is not None:
                met = Criterion('enough', None, None, met=enough(demos, options[name]))
                features = options[name].features
                summary = replace(summary, features=features, criteria=(met,))
            elif demo.exam:
                summary = with_verdicts(summaries[name], demos, thresholds.exam)
            else:
                before = taught_before(name, lesson.demonstrations(), domain, rules.seed)
                summary = judge(demos, domain, thresholds, rules.seed, options[name], before)
        summaries[name] = summary
        lesson.update_summaries(list(summaries.values()))

    def take(source: Source, action: str) -> None:
        """Take a step of the game, and pass its state to the lesson."""
        nonlocal newest
        command = Command('teacher', 0, source, newest.episode, newest.step, action)
        reply = game.command(command)
        if not isinstance(reply, Accepted):
            raise LessonError(f'the game refused {action}: {reply.detail}')
        newest = reply.transition
        lesson.add_transition(newest)

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
        starts, run = SeededStarts(domain, rules), None
        lesson = Lesson(domain, store, starts, clock=lambda: seconds, today=lambda: '')
        while True:
            view = lesson.view
            try:
                act = person.next_act(view, newest, running=run is not None)
            except TeacherError as error:
                cut_short = str(error)
                break
            watch(view, newest, list(summaries.values()), act)
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
            if isinstance(act, RunOption):
                here, state = (newest.episode, newest.step), domain.decode(newest.state)
                unstick = generator(rules.seed, 'random moves', act.option_name, *here)
                run = Run(options[act.option_name], domain, state, here, unstick=unstick)
                continue
            if isinstance(act, Drive):
                take(Source.PERSON, act.action)
                continue
            if isinstance(act, Watch):
                assert run is not None
                take(Source.MACHINE, domain.actions[run.next_action()].name)
                seen = newest.reward, newest.terminated, newest.truncated
                if run.observe(domain.decode(newest.state), *seen) is not None:
                    run = None
                continue
            if isinstance(act, EndDemonstration):
                run = None
            answer = lesson.carry_out(act)
            if not answer.carried_out:
                raise LessonError(answer.detail)
            if isinstance(act, BeginDemonstration):
                begun = game.reset(answer.state, answer.seed, Source.PERSON).transition
                if begun is None:
                    raise LessonError(f'the game does not begin in {answer.state}')
                if act.exam:
                    game.release('the machine is watched')
                newest = begun
                lesson.began(newest.episode, newest.state)
                lesson.add_transition(newest)
            if answer.demonstration is not None:
                learn(answer.demonstration)
                shown_there += tried and not judged([answer.demonstration])
                if tried and shown_there < where_stuck:
                    plan()
                elif tried:
                    break
        everything = lesson.demonstrations()
    return Taught(
        tuple(shown(everything)),
        tuple(options.values()),
        tuple(summaries[name] for name in options),
        tuple(judged(everything)),
        seconds,
        cut_short,
        acts,
    )
