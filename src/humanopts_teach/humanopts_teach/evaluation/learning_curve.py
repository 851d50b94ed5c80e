"""How an option was learned, demonstration by demonstration."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.reference import ReferenceOption
from humanopts_learner.demonstrations import Demonstration, Kind
from humanopts_learner.options.criteria import Criterion, judge, Judgement, Thresholds
from humanopts_learner.options.learn import learn_option
from humanopts_learner.options.option import LearnedOption
from humanopts_teach.evaluation.options_block import accuracies, finite

OnPoint = Callable[[int], object]  # told how many demonstrations were looked at


@dataclass(frozen=True)
class CurvePoint:
    """An option as it was after some of its demonstrations."""

    n_demonstrations: int  # trajectories
    n_not_here: int
    seconds: float  # of the person's time so far
    policy_accuracy: float | None
    classification_accuracy_initiation: float | None
    classification_accuracy_termination: float | None
    criteria: tuple[Criterion, ...]
    criteria_met: bool

    def to_dict(self) -> dict[str, Any]:
        """Return the point as JSON data, the criteria by name."""
        criteria = {
            c.name: {'value': finite(c.value), 'threshold': c.threshold, 'met': c.met}
            for c in self.criteria
        }
        return {**asdict(self), 'criteria': criteria}


@dataclass(frozen=True)
class Learned:
    """An option learned again, and how it came to be."""

    option: LearnedOption
    judgement: Judgement
    curve: tuple[CurvePoint, ...]


def learn_again(
    demonstrations: Sequence[Demonstration],
    domain: Domain[Any],
    thresholds: Thresholds,
    seed: int,
    reference: ReferenceOption | None = None,
    on_point: OnPoint | None = None,
) -> Learned:
    """
    Learn an option and judge it after every demonstration, from the first trajectory on.

    :param demonstrations: of one participant and option, checked, in order.
    :param reference: for the accuracies, which are None without it.
    :raises NotLearnableError: there is no trajectory.
    """
    points = []
    first = next((i for i, d in enumerate(demonstrations) if d.kind is Kind.TRAJECTORY), 0)
    for count in range(first + 1, len(demonstrations) + 1):
        seen = demonstrations[:count]
        option = learn_option(seen, domain, seed)
        judgement = judge(seen, domain, thresholds, seed, option)
        measured = accuracies(option, domain, reference)
        points.append(_point(option, seen, judgement, measured))
        if on_point is not None:
            on_point(count)
    return Learned(option, judgement, tuple(points))


def _point(
    option: LearnedOption,
    seen: Sequence[Demonstration],
    judgement: Judgement,
    measured: tuple[float | None, float | None, float | None],
) -> CurvePoint:
    return CurvePoint(
        option.n_demonstrations,
        option.n_not_here,
        sum(demo.seconds for demo in seen),
        *measured,
        criteria=judgement.criteria,
        criteria_met=judgement.criteria_met,
    )
