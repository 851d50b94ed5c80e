"""Evaluating a bag: every option learned again from the recorded demonstrations alone."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from humanopts_env.domains.base import Domain, is_enumerable
from humanopts_env.domains.reference import ReferenceOption
from humanopts_env.domains.registry import reference_options
from humanopts_learner.demonstrations import (
    check_demonstration,
    Demonstration,
    DemonstrationError,
    group_by_option,
    Kind,
)
from humanopts_learner.options.criteria import Judgement
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.planning.action_sets import HUMAN, PRIMITIVE
from humanopts_learner.planning.any_domain import AnyPlan, judge_plan, plan_in, PlanRequest
from humanopts_learner.planning.errors import PlanError
from humanopts_teach.bags.demonstrations import read_demonstrations, read_domain
from humanopts_teach.bags.errors import BagError
from humanopts_teach.bags.reader import Bag, open_bag
from humanopts_teach.evaluation.games import GAMES, GamesEvaluation
from humanopts_teach.evaluation.learning_curve import CurvePoint, learn_again
from humanopts_teach.evaluation.options_block import option_block, OptionBlock
from humanopts_teach.evaluation.planning import PlanningRow, row_of_plan
from humanopts_teach.evaluation.reproduction import (
    attached_options,
    compare_options,
    software_notes,
)
from humanopts_teach.evaluation.settings import Settings, settings_from_facts
from humanopts_teach.evaluation.text import evaluation_text

EPISODES = 100  # that plans are judged by, where models are exact
FACTS = 'humanopts'  # the bag's metadata record of the lesson's settings

OnProgress = Callable[[int, int, str], object]  # done, total, what is under way


class EvaluationError(BagError):
    """A bag cannot be evaluated; the text says why."""


@dataclass(frozen=True)
class OptionEvaluation:
    """One option of one participant, learned again."""

    participant: str
    block: OptionBlock
    option: LearnedOption
    judgement: Judgement
    curve: tuple[CurvePoint, ...]
    reproduced: bool | None = None  # equal to the option file in the bag; None: there is none

    def to_dict(self) -> dict[str, Any]:
        """Return the evaluation as JSON data."""
        return {
            'participant': self.participant,
            **self.block.to_dict(),
            'n_not_here': self.option.n_not_here,
            'equals_option_file': self.reproduced,
            'learning_curve': [point.to_dict() for point in self.curve],
        }


@dataclass(frozen=True)
class PlanEvaluation:
    """A plan with the options of one participant; with primitive actions, of none."""

    participant: str
    plan: AnyPlan
    row: PlanningRow


@dataclass(frozen=True)
class BagEvaluation:
    """What a bag alone says about what was taught."""

    domain: Domain[Any]
    settings: Settings
    options: tuple[OptionEvaluation, ...]  # in order of first demonstration
    plans: tuple[PlanEvaluation, ...]
    warnings: tuple[str, ...]  # what was assumed or left out, in words
    games: Mapping[str, GamesEvaluation] = field(default_factory=dict)  # by participant; if asked

    @property
    def blocks(self) -> tuple[OptionBlock, ...]:
        """The options block of summary.json."""
        return tuple(option.block for option in self.options)

    @property
    def planning(self) -> tuple[PlanningRow, ...]:
        """The planning block of summary.json."""
        return tuple(plan.row for plan in self.plans)

    @property
    def plan_names(self) -> tuple[str, ...]:
        """What the plans are called: by action set, and whose, where several people taught."""
        several = len({option.participant for option in self.options}) > 1
        return tuple(
            f'{plan.row.action_set} by {plan.participant}'
            if several and plan.participant
            else plan.row.action_set
            for plan in self.plans
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the evaluation as JSON data, without NaN."""
        return {
            'domain': self.domain.name,
            'domain_parameters': dict(self.domain.parameters),
            **self.settings.to_dict(),
            'options': [option.to_dict() for option in self.options],
            'planning': [
                {'participant': plan.participant, **plan.row.to_dict()} for plan in self.plans
            ],
            'games': {person: found.to_dict() for person, found in self.games.items()},
            'warnings': list(self.warnings),
        }

    def to_text(self) -> str:
        """Return tables for a terminal; warnings are not in them."""
        return evaluation_text(self)


def judged_by(domain: Domain[Any]) -> int:
    """Return how many episodes plans are judged by, where nothing else is asked."""
    return EPISODES if is_enumerable(domain) else GAMES


def evaluate_bag(
    bag: str | Path | Bag, progress: OnProgress | None = None, episodes: int = 0
) -> BagEvaluation:
    """
    Evaluate a bag with the settings that it carries.

    :param progress: called as the work goes on.
    :param episodes: that plans are judged by; 0: as many as is usual in the domain.
    :raises BagError: it is not a readable bag.
    :raises EvaluationError: it holds no demonstration to learn from.
    """
    opened = open_bag(bag) if isinstance(bag, str | Path) else bag
    domain = read_domain(opened)
    facts = opened.metadata.get(FACTS, {})
    settings, assumed = settings_from_facts(facts)
    demonstrations, attached = read_demonstrations(opened), attached_options(opened)
    warnings = [*opened.damage.splitlines(), *assumed, *software_notes(facts)]
    found = evaluate(demonstrations, domain, settings, warnings, progress, episodes)
    learned = [evaluated.option for evaluated in found.options]
    equal, differing = compare_options(attached, learned, demonstrations)
    options = (
        replace(each, reproduced=equal.get((each.participant, each.block.name)))
        for each in found.options
    )
    return replace(found, options=tuple(options), warnings=(*found.warnings, *differing))


def evaluate(
    demonstrations: Sequence[Demonstration],
    domain: Domain[Any],
    settings: Settings,
    warnings: Sequence[str] = (),
    progress: OnProgress | None = None,
    episodes: int = 0,
) -> BagEvaluation:
    """
    Learn every option of every participant, and plan with them.

    :param episodes: that plans are judged by; 0: as many as is usual in the domain.
    :raises EvaluationError: there is no demonstration to learn from.
    """
    groups, notes = _usable(demonstrations, domain)
    if not groups:
        raise EvaluationError('; '.join(['the bag holds no demonstration to learn from', *notes]))
    people = list(dict.fromkeys(participant for participant, _ in groups))
    work = _Progress(progress, sum(map(len, groups.values())) + len(people) + 1)
    references = reference_options(domain)
    options = []
    for (_, name), demos in groups.items():
        options.append(_learn(demos, domain, settings, references.get(name), work))
    judged = episodes or judged_by(domain)
    plans, refused = _plans(options, people, domain, settings, judged, work)
    return BagEvaluation(
        domain, settings, tuple(options), tuple(plans), (*warnings, *notes, *refused)
    )


class _Progress:
    def __init__(self, tell: OnProgress | None, total: int) -> None:
        self._tell, self._total, self.done = tell, total, 0

    def reach(self, done: int, text: str) -> None:
        """Report how many parts are done."""
        self.done = done
        if self._tell is not None:
            self._tell(done, self._total, text)


def _usable(
    demonstrations: Sequence[Demonstration], domain: Domain[Any]
) -> tuple[dict[tuple[str, str], list[Demonstration]], list[str]]:
    """Group what can be learned from; say what is left out."""
    good, notes = [], []
    for demo in demonstrations:
        try:
            check_demonstration(demo, domain)
            good.append(demo)
        except DemonstrationError as error:
            notes.append(f'demonstration {demo.uuid} of {demo.option_name!r} is left out: {error}')
    groups = group_by_option(good)
    for (participant, name), demos in list(groups.items()):
        if all(demo.kind is Kind.NOT_HERE for demo in demos):
            notes.append(f'{name!r} by {participant} has only "not here" answers: not learned')
            del groups[participant, name]
    return groups, notes


def _learn(
    demos: Sequence[Demonstration],
    domain: Domain[Any],
    settings: Settings,
    reference: ReferenceOption | None,
    work: _Progress,
) -> OptionEvaluation:
    first, before = demos[0], work.done

    def on_point(count: int) -> None:
        work.reach(before + count, f'{first.option_name}: demonstration {count} of {len(demos)}')

    learned = learn_again(demos, domain, settings.thresholds, settings.seed, reference, on_point)
    block = option_block(learned.option, learned.judgement, domain, reference)
    return OptionEvaluation(
        first.participant, block, learned.option, learned.judgement, learned.curve
    )


def _plans(
    options: Sequence[OptionEvaluation],
    people: Sequence[str],
    domain: Domain[Any],
    settings: Settings,
    episodes: int,
    work: _Progress,
) -> tuple[list[PlanEvaluation], list[str]]:
    """Plan with each participant's options, then with primitive actions."""
    requests = [*((person, HUMAN) for person in people), ('', PRIMITIVE)]
    plans, refused = [], []
    for person, action_set in requests:
        work.reach(work.done + 1, f'planning with {action_set} actions')
        chosen = [o.option for o in options if o.participant == person]
        request = PlanRequest(action_set, seed=settings.seed)
        try:
            plan = plan_in(domain, chosen, request)
            row = row_of_plan(plan, judge_plan(plan, settings.seed, episodes))
        except PlanError as error:
            refused.append(f'no plan with {action_set} actions: {error}')
            continue
        plans.append(PlanEvaluation(person, plan, row))
    return plans, refused
