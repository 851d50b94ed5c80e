"""Evaluation of a bag: every option learned again from its demonstrations, and planned with."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, partial
import json
import math
from pathlib import Path
import time
from typing import Any

from humanopts_env.domains.base import Domain, is_enumerable
from humanopts_env.domains.registry import reference_options
from humanopts_learner.demonstrations import (
    check_demonstration,
    Demonstration,
    DemonstrationError,
    group_by_option,
    Kind,
)
from humanopts_learner.options.criteria import judge
from humanopts_learner.options.files import FORMAT, option_to_json
from humanopts_learner.options.learn import learn_option
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.planning.exact import ExactPlan
from humanopts_learner.planning.interruption import exact_mean_return
from humanopts_learner.planning.plan import AnyPlan, judge_plan, make_plan, Performance
from humanopts_learner.planning.request import (
    batch_games,
    HUMAN,
    PlanError,
    PlanRequest,
    PRIMITIVE,
)
from humanopts_learner.planning.sampled.plan import SampledPlan
from humanopts_learner.summary import OptionSummary
from humanopts_ros.limits import parse_json
from humanopts_teach.bags import BagError
from humanopts_teach.bags.contents import read_demonstrations, read_domain
from humanopts_teach.bags.provenance import software, UNKNOWN
from humanopts_teach.bags.reader import Bag, ignore_progress, open_bag
from humanopts_teach.evaluation.games import (
    evaluate_games,
    GAMES,
    GamesEvaluation,
    judged_plan,
    PlayKey,
    ProgressCallback,
)
from humanopts_teach.evaluation.measures import (
    finite,
    option_block,
    OptionBlock,
    PlanningRow,
    row_of_plan,
    Settings,
    settings_from_facts,
)
from humanopts_teach.evaluation.side_by_side import all_of, Meanwhile

EPISODES = 100  # that plans are judged by, where models are exact
SOFTWARE = ('humanopts_version', 'numpy', 'scikit-learn')  # that learning depends on
_OF_CURVE = (  # fields of an OptionBlock that a learning curve has
    'n_demonstrations',
    'policy_accuracy',
    'classification_accuracy_initiation',
    'classification_accuracy_termination',
    'criteria_met',
)
Key = tuple[str, str]  # participant and name of an option


class EvaluationError(BagError):
    """A bag cannot be evaluated; the text says why."""


@dataclass(frozen=True)
class CurvePoint:
    """An option as it was after some of its demonstrations."""

    option: LearnedOption = field(compare=False)
    judgement: OptionSummary
    block: OptionBlock
    seconds: float  # of the person's time so far

    def to_dict(self) -> dict[str, Any]:
        """Return the point as JSON data, the criteria by name."""
        return {
            **{name: getattr(self.block, name) for name in _OF_CURVE},
            'n_not_here': self.option.n_not_here,
            'seconds': self.seconds,
            'criteria': {
                c.name: {
                    'value': finite(c.value),
                    'high': finite(c.high),
                    'threshold': finite(c.threshold),
                    'met': c.met,
                }
                for c in self.judgement.criteria
            },
        }


@dataclass(frozen=True)
class OptionEvaluation:
    """One option of one participant, learned again."""

    participant: str
    curve: tuple[CurvePoint, ...]  # from the first trajectory on; the last is the whole option
    reproduced: bool | None = None  # equals the option file in the bag; None: there is none

    @property
    def last(self) -> CurvePoint:
        """The option with all its demonstrations."""
        return self.curve[-1]

    def to_dict(self) -> dict[str, Any]:
        """Return the evaluation as JSON data."""
        return {
            'participant': self.participant,
            **asdict(self.last.block),
            'n_not_here': self.last.option.n_not_here,
            'equals_option_file': self.reproduced,
            'learning_curve': [point.to_dict() for point in self.curve],
        }


@dataclass(frozen=True)
class PlanEvaluation:
    """A plan with the options of one participant; with primitive actions, of none."""

    participant: str
    plan: AnyPlan
    row: PlanningRow
    judged: Performance = field(compare=False, repr=False)

    @cached_property
    def exact_mean_return(self) -> float | None:
        """Undiscounted, over all start states; None where it is not known exactly."""
        return exact_mean_return(self.plan) if isinstance(self.plan, ExactPlan) else None


@dataclass(frozen=True)
class BagEvaluation:
    """The options and plans that come out of a bag alone."""

    domain: Domain[Any]
    settings: Settings
    options: tuple[OptionEvaluation, ...]  # in order of first demonstration
    plans: tuple[PlanEvaluation, ...]
    warnings: tuple[str, ...]  # sentences on what was assumed or left out
    games: Mapping[str, GamesEvaluation] = field(default_factory=dict)  # by participant; if asked
    demonstrations: Sequence[Demonstration] = field(default=(), compare=False, repr=False)
    """All that were given, also those that were taken back or left out."""

    @property
    def blocks(self) -> tuple[OptionBlock, ...]:
        """The options block of summary.json."""
        return tuple(option.last.block for option in self.options)

    @property
    def planning(self) -> tuple[PlanningRow, ...]:
        """The planning block of summary.json."""
        return tuple(plan.row for plan in self.plans)

    @property
    def people(self) -> tuple[str, ...]:
        """The participants, in order of their first demonstrations."""
        return tuple(dict.fromkeys(option.participant for option in self.options))

    def of(self, participant: str) -> list[OptionEvaluation]:
        """Return the options of one participant."""
        return [option for option in self.options if option.participant == participant]

    def unready(self, plan: PlanEvaluation) -> list[str]:
        """Return the options of a plan whose criteria do not hold."""
        blocks = [option.last.block for option in self.of(plan.participant)]
        return [block.name for block in blocks if not block.criteria_met]

    @property
    def named_plans(self) -> dict[str, PlanEvaluation]:
        """The plans by action set and, where several people taught, person."""
        several = len(self.people) > 1
        return {
            f'{plan.row.action_set} by {plan.participant}'
            if several and plan.participant
            else plan.row.action_set: plan
            for plan in self.plans
        }

    def to_dict(self) -> dict[str, Any]:
        """Return the evaluation as JSON data, without NaN."""
        return {
            'domain': self.domain.name,
            'domain_parameters': dict(self.domain.parameters),
            **self.settings.to_dict(),
            'options': [option.to_dict() for option in self.options],
            'planning': [
                {'participant': plan.participant, **asdict(plan.row)} for plan in self.plans
            ],
            'games': {person: found.to_dict() for person, found in self.games.items()},
            'warnings': list(self.warnings),
        }


def judged_by(domain: Domain[Any]) -> int:
    """Return how many episodes plans are judged by, where nothing else is asked."""
    return EPISODES if is_enumerable(domain) else GAMES


def evaluate_bag(
    bag: str | Path | Bag,
    progress: ProgressCallback = ignore_progress,
    episodes: int = 0,
    jobs: int = 0,
) -> BagEvaluation:
    """
    Evaluate a bag with the settings that it carries.

    :param progress: called as the work goes on.
    :param episodes: that plans are judged by; 0: as many as is usual in the domain.
    :param jobs: processes that do the work; 0: one for each core, but this one where plans are
        exact, as they take less time than processes to start.
    :raises BagError: it is not a readable bag.
    :raises EvaluationError: it holds no demonstration to learn from.
    """
    opened = open_bag(bag) if isinstance(bag, str | Path) else bag
    domain = read_domain(opened)
    settings, assumed = settings_from_facts(opened.graph_facts)
    demonstrations, attached = read_demonstrations(opened), attached_options(opened)
    warnings = [*opened.notes, *assumed, *software_notes(opened.facts)]
    jobs = jobs or int(is_enumerable(domain))
    found = evaluate(demonstrations, domain, settings, warnings, progress, episodes, jobs)
    learned = [evaluated.last.option for evaluated in found.options]
    equal, differing = compare_options(attached, learned, demonstrations)
    options = (
        replace(each, reproduced=equal.get((each.participant, each.last.option.name)))
        for each in found.options
    )
    return replace(found, options=tuple(options), warnings=(*found.warnings, *differing))


def evaluate(
    demonstrations: Sequence[Demonstration],
    domain: Domain[Any],
    settings: Settings,
    warnings: Sequence[str] = (),
    progress: ProgressCallback = ignore_progress,
    episodes: int = 0,
    jobs: int = 1,
) -> BagEvaluation:
    """
    Learn every option of every participant, and plan with them.

    :param episodes: that plans are judged by; 0: as many as is usual in the domain.
    :param jobs: processes that do the work; 0: one for each core; 1: this one.
    :raises EvaluationError: there is no demonstration to learn from.
    """
    groups, notes = usable_demonstrations(demonstrations, domain)
    if not groups:
        raise EvaluationError('; '.join(['the bag holds no demonstration to learn from', *notes]))
    requests = list(dict.fromkeys([*((person, HUMAN) for person, _ in groups), ('', PRIMITIVE)]))
    work: list[tuple[Callable[[], Any], str, float]] = []  # call, name and cost
    for (_, name), demos in groups.items():
        call = partial(_learning_curve, demos, domain, settings)
        work.append((call, f'{name}: {len(demos)} demonstrations', len(demos)))
    for person, action_set in requests:
        taught = [demos for (taught_by, _), demos in groups.items() if taught_by == person]
        request = PlanRequest(action_set, game_steps=settings.game_steps, seed=settings.seed)
        plan = partial(_evaluate_plan, taught, domain, request, episodes or judged_by(domain))
        work.append((plan, f'planning with {action_set} actions', math.inf))
    progress(0, len(work), f'{len(demonstrations)} demonstrations')
    calls, names, costs = zip(*work)
    results = all_of(calls, names, costs, progress, jobs)
    options = [
        OptionEvaluation(participant, curve) for (participant, _), curve in zip(groups, results)
    ]
    plans = []
    for (person, action_set), found in zip(requests, results[len(groups) :]):
        if isinstance(found, PlanError):
            notes.append(f'no plan with {action_set} actions: {found}')
        else:
            plans.append(PlanEvaluation(person, found[0], row_of_plan(*found), found[1]))
    return BagEvaluation(
        domain,
        settings,
        tuple(options),
        tuple(plans),
        (*warnings, *notes),
        demonstrations=demonstrations,
    )


def usable_demonstrations(
    demonstrations: Sequence[Demonstration], domain: Domain[Any]
) -> tuple[dict[Key, list[Demonstration]], list[str]]:
    """Group the demonstrations by option; return sentences on those that are left out."""
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


def _learning_curve(
    demos: Sequence[Demonstration], domain: Domain[Any], settings: Settings
) -> tuple[CurvePoint, ...]:
    """Learn an option after every demonstration, from the first trajectory on."""
    reference = reference_options(domain).get(demos[0].option_name)
    first = next(i for i, demo in enumerate(demos, start=1) if demo.kind is Kind.TRAJECTORY)
    curve = []
    for count in range(first, len(demos) + 1):
        seen = demos[:count]
        option = learn_option(seen, domain, settings.seed)
        judgement = judge(seen, domain, settings.thresholds, settings.seed, option)
        block = option_block(option, judgement, domain, reference)
        seconds = sum(demo.seconds for demo in seen)
        curve.append(CurvePoint(option, judgement, block, seconds))
    return tuple(curve)


def _evaluate_plan(
    taught: Sequence[Sequence[Demonstration]],
    domain: Domain[Any],
    request: PlanRequest,
    episodes: int,
) -> tuple[AnyPlan, Performance] | PlanError:
    """
    Plan with what is learned from the demonstrations of each option, and judge the plan.

    :return: the error where no plan can be made.
    """
    options = [learn_option(demos, domain, request.seed) for demos in taught]
    try:
        clock = time.process_time  # no other program's work makes it longer
        plan = make_plan(domain, options, request, clock=clock)
        return plan, judge_plan(plan, request.seed, episodes)
    except PlanError as error:
        return error


def attached_options(bag: Bag) -> dict[Key, Mapping[str, Any]]:
    """Return the option files that are attached to a bag; a damaged one is noted there."""
    found: dict[Key, Mapping[str, Any]] = {}
    for file in bag.attached():
        try:
            data = parse_json(file.data.decode())
        except ValueError:
            continue  # another kind of file
        if isinstance(data, dict) and data.get('format') == FORMAT:
            found[str(data.get('participant')), str(data.get('name'))] = data
    return found


def compare_options(
    attached: Mapping[Key, Mapping[str, Any]],
    options: Sequence[LearnedOption],
    demonstrations: Sequence[Demonstration],
) -> tuple[dict[Key, bool], list[str]]:
    """
    Compare option files with the same options learned again.

    :param attached: option files; automatic options, which have no demonstrations, are skipped.
    :param demonstrations: that the options were learned from, among others.
    :return: whether they are equal to the last digit, and in words where they are not.
    """
    by_uuid = {demo.uuid: demo for demo in reversed(demonstrations)}
    equal: dict[Key, bool] = {}
    notes = []
    for option in options:
        key = (option.participant, option.name)
        if key in attached:
            file, shown = attached[key], [by_uuid[uuid] for uuid in option.uuids]
            again = json.loads(option_to_json(option, shown))
            wrong = [part for part in again if again[part] != file.get(part)]
            equal[key] = not wrong
            if wrong:
                notes.append(f'{_named(key)} differs from its option file: {", ".join(wrong)}')
    lone = [key for key, file in attached.items() if key not in equal and file.get('uuids')]
    notes += [f'{_named(key)} has an option file, but was not learned again' for key in lone]
    return equal, notes


def software_notes(facts: Mapping[str, str]) -> list[str]:
    """Return a sentence for each package that has another version than at the recording."""
    now = software()
    return [
        f'recorded with {name.removesuffix("_version")} {facts[name]}, and this is {now[name]}: '
        'numbers may differ'
        for name in SOFTWARE
        if facts.get(name, UNKNOWN) not in (UNKNOWN, now[name])
    ]


def _named(key: Key) -> str:
    return f'{key[1]!r} by {key[0]}'


def check_games(domain: Domain[Any]) -> None:
    """
    Check that plans can be compared in many games.

    :raises EvaluationError: plans of the domain are exact, or it cannot play many games.
    """
    if is_enumerable(domain):
        raise EvaluationError(f'plans in {domain.name} are exact: there is nothing to estimate')
    try:
        batch_games(domain)
    except PlanError as error:
        raise EvaluationError(f'the games cannot be played: {error}') from error


def with_games(
    evaluation: BagEvaluation,
    games: int = GAMES,
    progress: ProgressCallback = ignore_progress,
    earlier: Meanwhile[PlayKey, Any] | None = None,
) -> BagEvaluation:
    """
    Compare each participant's options with their baselines in many games.

    :param games: that each way to play is judged by, two or more.
    :param progress: called as the work goes on.
    :param earlier: as of ``evaluate_games``.
    :raises EvaluationError: plans of the domain are exact, or it cannot play many games.
    """
    domain, people, settings = evaluation.domain, evaluation.people, evaluation.settings
    check_games(domain)
    found = {}
    for number, person in enumerate(people):
        options = [each.last.option for each in evaluation.of(person)]
        judged = dict(
            judged_plan(each.plan, each.judged, settings.seed)
            for each in evaluation.plans
            if each.participant == person and isinstance(each.plan, SampledPlan)
        )

        def report(done: float, total: float, text: str, before: int = number) -> None:
            progress(before + done / total, len(people), text)

        try:
            found[person] = evaluate_games(
                *(domain, options, settings.seed, games, settings.game_steps),
                progress=report,
                known=judged,
                earlier=earlier,
            )
        except PlanError as error:
            raise EvaluationError(f'the games cannot be played: {error}') from error
    return replace(evaluation, games=found)
