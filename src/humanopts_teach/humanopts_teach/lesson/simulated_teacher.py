"""
A simulated teacher for demos, tests and experiments.

Assumptions and simplifications:

- It uses the domain's reference option as the meaning of an option, and answers each feature
  question accordingly; with ``extra_feature_rate``, it also says yes to irrelevant features.
- Among equally good actions, it has a fixed preference: the order of the reference option, or a
  random order per participant (``own_habits``).
- Before each step, it errs with probability ``error_rate``: it takes a uniformly random action
  among those that are not optimal. It does not undo the error, but continues.
- It answers questions about runs, and judges runs in the exam, by the reference option
  (``Examiner``). It watches step by step, stops a run that has gone wrong, and is always correct.
- It says "not here" exactly where the reference option cannot start, and "done" in the first state
  after at least one step in which the reference option ends. These verdicts are always correct.
- A demonstration is discarded and repeated if an error ended it, if no optimal action is left, or
  if it exceeds ``step_limit``. Since the reference option may not reach its end from everywhere,
  the teacher begins at a start of the task after ``attempts`` failures in a row, and gives up
  after ``ELSEWHERE`` such starts.

Every draw is keyed by seed, participant, option, number of the demonstration, attempt and step, so
the same seed gives the same demonstrations, regardless of other events on the graph.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from humanopts_env.domains.base import Domain
from humanopts_env.domains.reference import ReferenceOption, StartDependent
from humanopts_env.domains.registry import reference_options
from humanopts_env.game import Transition
from humanopts_env.seeding import generator
from humanopts_teach.lesson.examiner import Examiner
from humanopts_teach.lesson.requests import (
    AnswerQuestion,
    BeginDemonstration,
    DefineOption,
    Drive,
    EndDemonstration,
    LessonRequest,
    LessonView,
    OpenSession,
    Phase,
    RunOption,
    Verdict,
)
import numpy as np

FINISHED = 'finished'  # status text of its node after everything is taught
ELSEWHERE = 3  # maximum number of other start states in a row


class TeacherError(RuntimeError):
    """The teacher cannot teach this; the message says why."""


@dataclass(frozen=True, slots=True)
class TeacherSettings:
    """The settings of a simulated teacher."""

    options: tuple[str, ...]  # names of reference options, taught in this order
    participant: str = 'simulated'
    session: str = 'simulated'
    error_rate: float = 0.0  # probability of an error before each step
    extra_feature_rate: float = 0.0  # probability of a wrong yes per irrelevant feature
    own_habits: bool = False  # use a random preference among actions
    where_stuck: bool = False  # finally, show options where a plan got stuck
    step_limit: int = 1000  # maximum number of steps per demonstration
    attempts: int = 10  # maximum number of discarded demonstrations in a row from one start
    seed: int = 0


@dataclass(frozen=True, slots=True)
class Watch:
    """Watch the next step of the running option, or its end."""


@dataclass(frozen=True, slots=True)
class Wait:
    """Wait until something changes."""

    reason: str  # completes "waits for ..."


@dataclass(frozen=True, slots=True)
class Finish:
    """Everything was taught."""


Act = LessonRequest | Drive | RunOption | Watch | Wait | Finish


class SimulatedTeacher:
    """Decides on the next action, from the state of the lesson and the game."""

    def __init__(
        self,
        domain: Domain,
        settings: TeacherSettings,
        references: Mapping[str, ReferenceOption] | None = None,
    ) -> None:
        """
        Prepare to teach.

        :param references: reference options by name; None: the domain's.
        :raises TeacherError: no options, an option without a reference, or an invalid setting.
        """
        self._domain, self._settings = domain, settings
        self._references = reference_options(domain) if references is None else references
        if not settings.options:
            raise TeacherError('no option to teach was given')
        if unknown := [name for name in settings.options if name not in self._references]:
            raise TeacherError(
                f'{domain.name} has no reference option {unknown[0]!r}; it has '
                f'{", ".join(self._references) or "none"}'
            )
        for name in ('error_rate', 'extra_feature_rate'):
            if not 0.0 <= (rate := getattr(settings, name)) < 1.0:
                raise TeacherError(f'{name} is {rate}, but must be at least 0 and below 1')
        for name in ('step_limit', 'attempts'):
            if (least := getattr(settings, name)) < 1:
                raise TeacherError(f'{name} is {least}, but must be 1 or more')
        self._finished: set[str] = set()
        self._tried = ('', 0)  # option and number of the current demonstration
        self._attempt = 0  # number of times it was discarded
        self._elsewhere = ''  # other start state; empty: the lesson's
        self._erred = False  # whether the last step was an error
        self._exam: Examiner | None = None  # of the current run in an exam
        self._seen = (0, 0)  # last episode and step seen
        self._order: list[int] | None = None  # preferred actions first
        if settings.own_habits:
            habits = self._generator('habits').permutation(len(domain.actions))
            self._order = habits.tolist()

    def next_act(self, lesson: LessonView, game: Transition, *, running: bool = False) -> Act:
        """
        Return the next action; call once per action carried out.

        :param game: newest state of the game; episode 0: not received yet.
        :param running: whether the option that the teacher runs is still running.
        :raises TeacherError: the teacher cannot demonstrate the option from the start state.
        """
        act = self._wanted(lesson, game, running)
        if lesson.paused and isinstance(
            act, OpenSession | DefineOption | AnswerQuestion | BeginDemonstration
        ):
            return Wait(f'the lesson to resume; it is paused: {lesson.paused}')
        return act

    def _wanted(self, lesson: LessonView, game: Transition, running: bool) -> Act:
        settings = self._settings
        if (lesson.participant, lesson.session) != (settings.participant, settings.session):
            return OpenSession(settings.participant, settings.session)
        if lesson.phase is Phase.FINISHED:
            self._finished.add(lesson.option_name)
        left = [name for name in settings.options if name not in self._finished]
        if not left and settings.where_stuck and lesson.stuck_options:
            return self._show_where_stuck(lesson, game)
        if not left:
            return Finish()
        if lesson.option_name != left[0]:
            # A feature of a reference option that the domain lacks is derived.
            known = {feature.name for feature in self._domain.features}
            features = self._references[left[0]].features
            derived = tuple(name for name in features if name not in known)
            return DefineOption(left[0], derived_features=derived)
        if lesson.phase is Phase.ASKING:
            yes = self.depends_on(lesson.option_name, lesson.question_feature)
            return AnswerQuestion(lesson.question_id, yes)
        if lesson.phase is Phase.CHECKING:
            examiner = self._examiner(lesson, lesson.question_states[0])
            for state in lesson.question_states[1:]:
                examiner.see(self._domain.decode(state))
            return AnswerQuestion(lesson.question_id, examiner.right)
        if lesson.phase is Phase.EXAM:
            return BeginDemonstration(exam=True)
        if lesson.phase is Phase.READY:
            return self._begin(lesson)
        if lesson.phase is Phase.DEMONSTRATING and lesson.exam:
            return self._examine(lesson, game, running)
        if lesson.phase is Phase.DEMONSTRATING:
            return self._demonstrate(lesson, game)
        return Wait('the learner')

    def _examiner(self, lesson: LessonView, start: str) -> Examiner:
        reference = self._reference(lesson, start)
        return Examiner(self._domain, reference, self._domain.decode(start))

    def _examine(self, lesson: LessonView, game: Transition, running: bool) -> Act:
        """Watch a run in the exam, and judge it."""
        if game.episode != lesson.episode:
            return Wait('the first state of the run')
        if self._exam is None or game.episode != self._seen[0]:
            self._exam, self._seen = self._examiner(lesson, game.state), (game.episode, 0)
            return RunOption(lesson.option_name, lesson.participant)
        here = game.episode, game.step
        if here != self._seen:
            self._exam.see(self._domain.decode(game.state), game.previous_action)
            self._seen = here
        failed = self._exam.failed
        if running and not failed:
            return Watch()
        verdict = Verdict.RIGHT if game.step and self._exam.right else Verdict.WRONG
        return EndDemonstration(verdict, *here, stopped=failed and self._exam.can_continue)

    def _show_where_stuck(self, lesson: LessonView, game: Transition) -> Act:
        """Show an option where a plan got stuck."""
        if lesson.phase is Phase.DEMONSTRATING:
            return self._demonstrate(lesson, game)
        if lesson.option_name != lesson.stuck_options[0]:
            return DefineOption(lesson.stuck_options[0])
        waits = lesson.phase is Phase.LEARNING
        return Wait('the learner') if waits else self._begin(lesson)

    def _begin(self, lesson: LessonView) -> BeginDemonstration:
        number = lesson.n_demonstrations + lesson.n_not_here + 1
        again = self._tried == (lesson.option_name, number)
        return BeginDemonstration(self._elsewhere if again else '')

    def depends_on(self, option_name: str, feature: str) -> bool:
        """Answer a feature question."""
        if feature in self._references[option_name].features:
            return True
        rng = self._generator('extra_feature', option_name, feature)
        return bool(rng.random() < self._settings.extra_feature_rate)

    def _demonstrate(self, lesson: LessonView, game: Transition) -> Act:
        if game.episode != lesson.episode:
            return Wait('the first state of the demonstration')
        number = lesson.n_demonstrations + lesson.n_not_here + 1
        if self._tried != (lesson.option_name, number):
            self._tried, self._attempt, self._elsewhere = (lesson.option_name, number), 0, ''
        reference = self._reference(lesson, lesson.start_state)
        state = self._domain.decode(game.state)
        here = (game.episode, game.step)
        if game.step == 0 and not reference.can_start(state):
            return EndDemonstration(Verdict.NOT_HERE, *here)
        if game.step > 0 and reference.ends(state):
            if self._erred:
                return self._discard(lesson, here)
            over = game.terminated or game.truncated
            return EndDemonstration(Verdict.DONE, *here, not over and reference.can_start(state))
        best = reference.optimal_actions(state)
        stuck = not best or game.step >= self._settings.step_limit
        if game.terminated or game.truncated or stuck:
            return self._discard(lesson, here)
        rng = self._generator('error', lesson.option_name, number, self._attempt, game.step)
        wrong = sorted(set(range(len(self._domain.actions))) - set(best))
        self._erred = bool(wrong) and rng.random() < self._settings.error_rate
        usual = best[0] if self._order is None else min(best, key=self._order.index)
        action = int(rng.choice(wrong)) if self._erred else usual
        return Drive(self._domain.actions[action].name, *here)

    def _reference(self, lesson: LessonView, start: str) -> ReferenceOption:
        """Return the reference option for a run from a start state."""
        reference = self._references[lesson.option_name]
        if isinstance(reference, StartDependent):
            return reference.begun(self._domain.decode(start))
        return reference

    def _discard(self, lesson: LessonView, here: tuple[int, int]) -> EndDemonstration:
        self._attempt += 1
        failed, spent = divmod(self._attempt, self._settings.attempts)
        if failed > ELSEWHERE:
            raise TeacherError(
                f'cannot show {lesson.option_name!r} from {lesson.start_state}: '
                f'{self._settings.attempts} demonstrations in a row did not reach the end'
            )
        if failed and not spent:
            rng = self._generator('elsewhere', *self._tried, failed)
            self._elsewhere = self._domain.encode(self._domain.reset(rng))
        return EndDemonstration(Verdict.DISCARD, *here)

    def _generator(self, purpose: str, *key: str | int) -> np.random.Generator:
        settings = self._settings
        return generator(settings.seed, 'teacher', purpose, settings.participant, *key)
