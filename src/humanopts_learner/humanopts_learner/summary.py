"""Summaries of options and plans, for messages, lessons, reports and tables."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
import math

from humanopts_learner.demonstrations import Demonstration, Kind, shown, TREES
from humanopts_learner.intervals import Interval, LEVEL
import numpy as np

SUCCESS, AGREEMENT, IMITATION = 'success', 'agreement', 'imitation'
RETURN, INITIATION, TERMINATION = 'return', 'initiation', 'termination'
CRITERIA = {  # with the measured quantity
    SUCCESS: 'share of starts from which it reaches an end like a demonstrated one',
    AGREEMENT: 'share of held-out demonstrations that it would repeat',
    IMITATION: 'share of demonstrations that end differently from the run from their start',
    RETURN: 'held-out shortfall in the return, as a share of its range',
    INITIATION: 'held-out balanced error of I',
    TERMINATION: 'share of held-out demonstrations in which it ends early, late or never',
}
EVERY_START, SAMPLED_STARTS, RECORDED = 'every start', 'sampled starts', 'recorded'  # evidence
NO_RANGE = 'random actions from the same starts achieve as high a return as the demonstrations'
NOT_MET = 'not learned: the criteria are not met'
NOT_JUDGED = 'not learned: some of its ends have not been judged'
NO_REFUSAL = 'the option can start in every state that was shown'
NO_OTHER_END = 'the option ends only where the task does'
ALL_MET = 'All criteria are met.'
UNKNOWN = Interval(math.nan, math.nan, math.nan)


@dataclass(frozen=True, slots=True)
class Criterion:
    """One stopping criterion."""

    name: str  # one of CRITERIA
    value: float | None  # 0..1, or above for a return; None: not measurable yet
    threshold: float | None  # smallest share, or largest error; None: no threshold
    met: bool
    limit: float | None = None  # confidence limit that decides; None: the value decides
    count: int = 0  # number of starts or demonstrations evaluated
    possible: float | None = None  # value of success if all ends not called wrong are right
    obstacle: str = ''  # why more demonstrations cannot make it measurable; empty: they can

    @classmethod
    def of(
        cls,
        name: str,
        value: float | None,
        threshold: float | None,
        limit: float | None = None,
        count: int = 0,
        possible: float | None = None,
    ) -> 'Criterion':
        """
        Return a criterion, which is met if its limit is on the right side of the threshold.

        :param limit: confidence limit; None: the value itself.
        """
        found = cls(name, value, threshold, False, limit, count, possible)
        return replace(found, met=found.meets(value if limit is None else limit))

    def meets(self, value: float | None) -> bool:
        """Return whether a value is on the right side of the threshold."""
        if value is None or self.threshold is None:
            return False
        return value >= self.threshold if self.at_least else value <= self.threshold

    @property
    def at_least(self) -> bool:
        """Whether the threshold is the smallest good value, rather than the largest."""
        return self.name in (SUCCESS, AGREEMENT)

    @property
    def measurable(self) -> bool:
        """Whether there are enough demonstrations of both classes."""
        return self.value is not None

    @property
    def undecided(self) -> bool:
        """Whether the value is good enough, but its confidence limit is not."""
        return self.meets(self.value) and not self.met

    @property
    def unanswered(self) -> bool:
        """Whether it would be met if the person called the option's unjudged ends right."""
        return not self.met and self.meets(self.possible)

    @property
    def verdict(self) -> str:
        """The result, as worded on screens and in reports."""
        if self.value is None:
            return 'not measurable' if self.obstacle else 'not yet measurable'
        return 'met' if self.met else 'not yet known' if self.undecided else 'not met'


@dataclass(frozen=True, slots=True)
class OptionSummary:
    """
    Summary of one option of one participant.

    Field names match the message OptionStatus and the columns of option tables.
    """

    option_name: str
    participant: str
    features: tuple[str, ...] = ()  # chosen with the newest demonstration
    method: str = TREES  # learning method, chosen with the newest demonstration
    n_demonstrations: int = 0  # trajectories
    n_not_here: int = 0  # "not here" answers
    last_uuid: str = ''  # newest demonstration or "not here" answer
    criteria: tuple[Criterion, ...] = ()  # in the order of CRITERIA; empty: no trajectory
    n_questions: int = 0  # answered questions about runs of the option
    exam_right: int = 0  # runs in the exam of this version that the person called right
    exam_runs: int = 0
    exam_needed: int = 0  # required number of runs; 0: no exam
    exams_failed: int = 0  # exams of earlier versions that ended with a wrong run
    evidence: str = ''  # evidence for success: EVERY_START, SAMPLED_STARTS or RECORDED
    ended_early: int = 0  # held-out demonstrations in which the option ends too early
    ended_late: int = 0  # the same, later than the person
    ended_never: int = 0  # the same, not within twice the steps
    mean_return_demonstrations: float = math.nan  # undiscounted
    mean_return_policy: float = math.nan  # in-sample: from the same start states
    gain: Interval = UNKNOWN  # mean_return_policy - mean_return_demonstrations
    more_needed: int = -1  # estimate of further demonstrations; 0: none; -1: unknown
    conflicts: tuple[str, ...] = ()  # situations with equal features but different labels
    advice: tuple[str, ...] = ()  # advice on the chosen features, the most important first

    @property
    def criteria_met(self) -> bool:
        """Whether each criterion is met, or impossible to measure."""
        return any(c.met for c in self.criteria) and all(
            c.met or c.obstacle for c in self.criteria
        )

    @property
    def settled(self) -> bool:
        """
        Whether no more demonstrations are needed.

        All criteria are then met, or will be if the person calls the ends of the option right.
        """
        met = any(c.met for c in self.criteria)
        return met and all(c.met or c.obstacle or c.unanswered for c in self.criteria)

    @property
    def exam(self) -> Interval:
        """The share of right runs in the exam; its limits hold over all exams of the option."""
        return share_right(self.exam_right, self.exam_runs, self.exams_failed)

    @property
    def exam_passed(self) -> bool:
        """Whether all runs of the exam were right."""
        return self.exam_right == self.exam_runs >= self.exam_needed

    @property
    def learned(self) -> bool:
        """Whether the criteria are met and the exam is passed."""
        return self.criteria_met and self.exam_passed

    @property
    def status(self) -> str:
        """Whether the option is learned and with what confidence, or what is missing."""
        if not self.criteria_met:
            return NOT_JUDGED if self.settled else NOT_MET
        runs = f'{self.exam_right} of {self.exam_runs} runs in the exam were right'
        if self.exam_right < self.exam_runs:
            return f'not learned: {runs}'
        if not self.exam_passed:
            runs = f'{self.exam_runs} of {self.exam_needed} runs'
            return f'not learned: the exam is incomplete ({runs})'
        if not self.exam_needed:
            return 'learned according to its criteria, without an exam'
        least = f'{100 * self.exam.low:.0f} %'
        return f'learned: {runs}, so at least {least} are, with 95 % confidence'

    @property
    def result(self) -> str:
        """Whether the criteria are met, as worded on screens."""
        if not self.settled:
            return 'Not all criteria are met.'
        if not self.criteria_met:
            return 'Some ends of the option have not been judged yet.'
        return f'{self.obstacles} The other criteria are met.' if self.obstacles else ALL_MET

    @property
    def obstacles(self) -> str:
        """The criteria that cannot be measured, with reasons; empty: none."""
        return ' '.join(
            f'The {criterion} cannot be measured: {obstacle}.'
            for criterion, obstacle in ((c.name, c.obstacle) for c in self.criteria)
            if obstacle
        )

    @property
    def reach(self) -> str:
        """Number of starts from which the option succeeds, as on screens; empty: unknown."""
        found = next((c for c in self.criteria if c.at_least and c.value is not None), None)
        if found is None or found.value is None:
            return ''
        count = round(found.value * found.count)
        of = f'{count} of {found.count}'
        if found.name == AGREEMENT:
            return f'It would repeat {of} demonstrations that it was not learned from.'
        other = round(((found.possible or 0.0) - found.value) * found.count)
        also = f', and from {other} it reaches one that you have not judged' if other > 0 else ''
        if self.evidence == EVERY_START:
            return f'Of all {found.count} starts, it reaches an end like yours from {count}{also}.'
        return f'It reaches an end like yours from {of} starts (drawn at random){also}.'


@dataclass(frozen=True, slots=True)
class PlanSummary:
    """
    Summary of a plan and its evaluation episodes.

    Field names match the message PlanResult and the columns of plan tables.
    """

    action_set: str
    option_names: tuple[str, ...] = ()  # columns of the action set
    gamma: float = 0.0  # discount per primitive step; 0: no plan
    n_states: int = 0  # number of states or abstract states
    game_steps: int = 0  # number of sampled or recorded steps; 0: models are exact
    recorded_runs: int = 0  # number of recorded runs used
    table_seconds: float = 0.0  # evaluating options in every state
    model_seconds: float = 0.0  # building models, including game steps
    sweep_seconds: float = 0.0  # value iteration
    sweeps: int = 0
    residual: float = 0.0  # largest change of the last sweep, reward units
    converged: bool = False  # residual is at most the tolerance
    evaluation_episodes: int = 0  # episodes for the results below
    mean_return: float = math.nan  # undiscounted, by the rules of the domain
    mean_return_low: float = math.nan  # 95 % confidence interval
    mean_return_high: float = math.nan
    mean_discounted_return: float = math.nan
    fallbacks: int = 0  # primitive actions taken because no option could start
    random_moves: int = 0  # moves taken because an option repeated itself
    outcomes: Mapping[str, Interval] = field(default_factory=dict)  # reported by the domain


def share_right(right: int, runs: int, failed: int) -> Interval:
    """
    Return the share of right runs in an exam; its limits hold over all exams of an option.

    :param failed: number of exams failed earlier.
    """
    return Interval.of_share(np.arange(runs) < right, 1 - (1 - LEVEL) / (failed + 1) ** 2)


def unmeasured(demonstrations: Sequence[Demonstration]) -> OptionSummary:
    """
    Return the summary of an option before learning.

    :param demonstrations: one or more, of the same participant and option, sorted by number.
    """
    counted = shown(demonstrations)
    newest = (counted or demonstrations)[-1]
    n_not_here = sum(demo.kind is Kind.NOT_HERE for demo in counted)
    return OptionSummary(
        newest.option_name,
        newest.participant,
        newest.chosen_features,
        newest.method,
        len(counted) - n_not_here,
        n_not_here,
        newest.uuid,
    )
