"""Evaluation of a bag: relearn every option from its demonstrations and plan with the options."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
import json
import math
from pathlib import Path
import time
from typing import Any, TYPE_CHECKING

from humanopts_env.domains.base import Domain, is_enumerable
from humanopts_env.domains.replayed_domain import ReplayedDomain
from humanopts_learner.demonstrations import (
    check_demonstration,
    Demonstration,
    DemonstrationError,
    group_by_option,
    judged,
    Kind,
    shown,
    version_of,
)
from humanopts_learner.options.files import FORMAT, option_to_json
from humanopts_learner.options.judge import judge, taught_before
from humanopts_learner.options.learn import learn_option
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_learner.planning.exact_plan import ExactPlan
from humanopts_learner.planning.interruption import exact_mean_return
from humanopts_learner.planning.plan import (
    AnyPlan,
    judge_plan,
    make_plan,
    Performance,
    summarise_plan,
)
from humanopts_learner.planning.request import (
    HUMAN,
    PlanError,
    PlanRequest,
    PRIMITIVE,
)
from humanopts_learner.summary import OptionSummary
from humanopts_ros.limits import parse_json
from humanopts_teach.bags import BagError
from humanopts_teach.bags.contents import read_demonstrations, read_domain
from humanopts_teach.bags.mcap_file import ignore_progress
from humanopts_teach.bags.provenance import software, UNKNOWN
from humanopts_teach.bags.reader import Bag, open_bag
from humanopts_teach.evaluation import ProgressCallback
from humanopts_teach.evaluation.games import (
    evaluate_games,
    GAMES,
    games_to_dict,
    REPLAYED_GAMES,
)
from humanopts_teach.evaluation.settings import EvaluationSettings, settings_from_facts
from humanopts_teach.evaluation.side_by_side import all_of, Jobs
from humanopts_teach.evaluation.tables import option_row, OPTIONS, plan_row, PLANS, records, table

if TYPE_CHECKING:
    import pandas as pd  # slow to import

EPISODES = 100  # per plan with exact models
SOFTWARE = ('humanopts_version', 'numpy', 'scikit-learn')  # packages that affect learning
Key = tuple[str, str]  # participant and option name


class EvaluationError(BagError):
    """A bag cannot be evaluated; the message gives the reason."""


@dataclass(frozen=True)
class OptionEvaluation:
    """
    One relearned option of one participant.

    :ivar summary: summary after all demonstrations.
    :ivar learning: one row per demonstration, starting with the first trajectory, with the
        verdicts on the option at that time; columns ``OPTIONS``.
    :ivar reproduced: whether it equals the option file in the bag; None: no file.
    :ivar judged: judged runs by number.
    """

    option: LearnedOption
    summary: OptionSummary
    learning: 'pd.DataFrame'
    reproduced: bool | None = None
    judged: Sequence[Demonstration] = ()

    @property
    def row(self) -> Any:
        """The last row of ``learning``, columns as attributes."""
        return next(self.learning.tail(1).itertuples(index=False))


@dataclass(frozen=True)
class PlanEvaluation:
    """A plan with the options of one participant, or with primitive actions only."""

    participant: str
    plan: AnyPlan
    judged: Performance


@dataclass(frozen=True)
class BagEvaluation:
    """
    The options and plans computed only from a bag.

    :ivar options: options in order of first demonstration.
    :ivar plans: plans by action set and, if several people taught, by person.
    :ivar warnings: sentences on assumptions and omissions.
    :ivar games: tables of ``evaluate_games`` by participant, if requested.
    :ivar demonstrations: all demonstrations and judged runs, including withdrawn and omitted ones.
    """

    domain: Domain
    settings: EvaluationSettings
    options: tuple[OptionEvaluation, ...]
    plans: Mapping[str, PlanEvaluation]
    warnings: tuple[str, ...] = ()
    games: Mapping[str, 'pd.DataFrame'] = field(default_factory=dict)
    demonstrations: Sequence[Demonstration] = ()

    @cached_property
    def option_table(self) -> 'pd.DataFrame':
        """One row per option, after all its demonstrations; columns ``OPTIONS``."""
        rows = [row for each in self.options for row in records(each.learning.tail(1))]
        return table(OPTIONS, rows)

    @cached_property
    def plan_table(self) -> 'pd.DataFrame':
        """One row per plan, indexed by name; columns ``PLANS``."""
        rows = [
            plan_row(
                summarise_plan(each.plan, each.judged),
                each.participant,
                exact_mean_return(each.plan) if isinstance(each.plan, ExactPlan) else None,
            )
            for each in self.plans.values()
        ]
        return table(PLANS, rows).set_axis([*self.plans])

    @property
    def people(self) -> list[str]:
        """The participants, in order of their first demonstrations."""
        return list(dict.fromkeys(each.option.participant for each in self.options))

    def of(self, participant: str) -> list[OptionEvaluation]:
        """Return the options of one participant."""
        return [each for each in self.options if each.option.participant == participant]

    def unready(self, plan: PlanEvaluation) -> list[str]:
        """Return the names of a plan's options that are not learned."""
        of = self.of(plan.participant)
        return [each.option.name for each in of if not each.summary.learned]

    def to_dict(self) -> dict[str, Any]:
        """Return the evaluation as JSON data, without NaN."""
        return {
            'domain': self.domain.name,
            'domain_parameters': dict(self.domain.parameters),
            **self.settings.to_dict(),
            'options': [
                {
                    **records(each.learning)[-1],
                    'equals_option_file': each.reproduced,
                    'learning_curve': records(each.learning),
                }
                for each in self.options
            ],
            'planning': records(self.plan_table),
            'games': {person: games_to_dict(games) for person, games in self.games.items()},
            'warnings': list(self.warnings),
        }


def judged_by(domain: Domain) -> int:
    """Return the default number of episodes for evaluating a plan."""
    if isinstance(domain, ReplayedDomain):
        return REPLAYED_GAMES
    return EPISODES if is_enumerable(domain) else GAMES


def evaluate_bag(
    bag: str | Path | Bag,
    progress: ProgressCallback = ignore_progress,
    episodes: int = 0,
    jobs: Jobs = 0,
) -> BagEvaluation:
    """
    Evaluate a bag with the settings stored in it.

    :param progress: callback after each part of the work.
    :param episodes: number of episodes per plan; 0: the default of the domain.
    :param jobs: as in ``all_of``; but 0 means only this process if plans are exact, since starting
        processes would take longer.
    :raises BagError: the bag cannot be read.
    :raises EvaluationError: the bag contains no demonstration to learn from.
    """
    opened = open_bag(bag) if isinstance(bag, str | Path) else bag
    domain = read_domain(opened)
    settings, assumed = settings_from_facts(opened.graph_facts)
    demonstrations, attached = read_demonstrations(opened), attached_options(opened)
    warnings = [*opened.notes, *assumed, *software_notes(opened.facts)]
    jobs = jobs or int(is_enumerable(domain))
    found = evaluate(demonstrations, domain, settings, warnings, progress, episodes, jobs)
    equal, differing = compare_options(attached, found.options, demonstrations)
    options = (
        replace(each, reproduced=equal.get((each.option.participant, each.option.name)))
        for each in found.options
    )
    return replace(found, options=tuple(options), warnings=(*found.warnings, *differing))


def evaluate(
    demonstrations: Sequence[Demonstration],
    domain: Domain,
    settings: EvaluationSettings,
    warnings: Sequence[str] = (),
    progress: ProgressCallback = ignore_progress,
    episodes: int = 0,
    jobs: Jobs = 1,
) -> BagEvaluation:
    """
    Learn every option of every participant, and plan with the options.

    :param episodes: number of episodes per plan; 0: the default of the domain.
    :param jobs: as in ``all_of``.
    :raises EvaluationError: there is no demonstration to learn from.
    """
    groups, notes = usable_demonstrations(demonstrations, domain)
    if not groups:
        raise EvaluationError('; '.join(['the bag holds no demonstration to learn from', *notes]))
    requests = list(dict.fromkeys([*((person, HUMAN) for person, _ in groups), ('', PRIMITIVE)]))
    work: list[tuple[Callable[[], Any], str, float]] = []  # call, name and cost of each
    kept = {demo.uuid for demos in groups.values() for demo in demos}
    for (person, name), demos in groups.items():
        of_person = [d for d in demonstrations if d.participant == person and d.uuid in kept]
        call = partial(_learning_curve, demos, of_person, domain, settings)
        count = len(shown(demos))
        work.append((call, f'{name}: {count} demonstrations', count))
    for person, action_set in requests:
        taught = [demos for (taught_by, _), demos in groups.items() if taught_by == person]
        request = PlanRequest(
            action_set,
            game_steps=settings.game_steps,
            seed=settings.seed,
            unstick=settings.unstick,
        )
        plan = partial(_evaluate_plan, taught, domain, request, episodes or judged_by(domain))
        work.append((plan, f'planning with {action_set} actions', math.inf))
    progress(0, len(work), f'{len(shown(demonstrations))} demonstrations')
    calls, names, costs = zip(*work)
    results = all_of(calls, names, costs, progress, jobs)
    plans, several = {}, len({person for person, _ in groups}) > 1
    for (person, action_set), found in zip(requests, results[len(groups) :]):
        name = f'{action_set} by {person}' if several and person else action_set
        if isinstance(found, PlanError):
            notes.append(f'no plan with {action_set} actions: {found}')
        else:
            plans[name] = PlanEvaluation(person, *found)
    options = tuple(results[: len(groups)])
    found_notes = (*warnings, *notes)
    return BagEvaluation(
        domain, settings, options, plans, found_notes, demonstrations=demonstrations
    )


def usable_demonstrations(
    demonstrations: Sequence[Demonstration], domain: Domain
) -> tuple[dict[Key, list[Demonstration]], list[str]]:
    """Group demonstrations and judged runs by option; also return a sentence on each omission."""
    good, notes = [], []
    for demo in demonstrations:
        try:
            check_demonstration(demo, domain)
            good.append(demo)
        except DemonstrationError as error:
            notes.append(f'demonstration {demo.uuid} of {demo.option_name!r} is left out: {error}')
    groups = group_by_option(good)
    for (participant, name), demos in list(groups.items()):
        if not any(demo.kind is Kind.TRAJECTORY for demo in demos):
            why = 'only "not here" answers' if shown(demos) else 'no demonstration left'
            notes.append(f'{name!r} by {participant} has {why}: not learned')
            del groups[participant, name]
    return groups, notes


def _learning_curve(
    demos: Sequence[Demonstration],
    of_person: Sequence[Demonstration],
    domain: Domain,
    settings: EvaluationSettings,
) -> OptionEvaluation:
    """
    Relearn an option after every demonstration, starting with the first trajectory.

    :param of_person: demonstrations of all options of the participant, in order.
    """
    before = taught_before(demos[0].option_name, of_person, domain, settings.seed)
    given, rows = shown(demos), []
    first = next(i for i, demo in enumerate(given, start=1) if demo.kind is Kind.TRAJECTORY)
    versions = [version_of(given[:count]) for count in range(len(given) + 1)]
    for count in range(first, len(given) + 1):
        seen, later = given[:count], versions[count + 1 :]
        option = learn_option(seen, domain, settings.seed)
        known = [*seen, *(run for run in judged(demos) if run.option_version not in later)]
        summary = judge(known, domain, settings.thresholds, settings.seed, option, before)
        rows.append(option_row(summary, option, domain, sum(demo.seconds for demo in seen)))
    return OptionEvaluation(option, summary, table(OPTIONS, rows), judged=judged(demos))


def _evaluate_plan(
    taught: Sequence[Sequence[Demonstration]],
    domain: Domain,
    request: PlanRequest,
    episodes: int,
) -> tuple[AnyPlan, Performance] | PlanError:
    """
    Learn each option from its demonstrations, plan with the options and evaluate the plan.

    :return: plan and performance, or the error if planning is impossible.
    """
    options = [learn_option(demos, domain, request.seed) for demos in taught]
    try:
        clock = time.process_time  # unaffected by other programs
        plan = make_plan(domain, options, request, clock=clock)
        return plan, judge_plan(plan, request.seed, episodes)
    except PlanError as error:
        return error


def attached_options(bag: Bag) -> dict[Key, Mapping[str, Any]]:
    """Return the option files attached to a bag; record damaged ones as damage of the bag."""
    found: dict[Key, Mapping[str, Any]] = {}
    for file in bag.attached():
        try:
            data = parse_json(file.data.decode())
        except ValueError:
            continue  # not an option file
        if isinstance(data, dict) and data.get('format') == FORMAT:
            found[str(data.get('participant')), str(data.get('name'))] = data
    return found


def compare_options(
    attached: Mapping[Key, Mapping[str, Any]],
    evaluated: Sequence[OptionEvaluation],
    demonstrations: Sequence[Demonstration],
) -> tuple[dict[Key, bool], list[str]]:
    """
    Compare option files with the relearned options.

    :param attached: option files; automatic options, which have no demonstrations, are skipped.
    :param demonstrations: all demonstrations, including those of the options.
    :return: whether each file is exactly equal, and a sentence on each difference.
    """
    by_uuid = {demo.uuid: demo for demo in reversed(demonstrations)}
    equal: dict[Key, bool] = {}
    notes = []
    for each in evaluated:
        option, key = each.option, (each.option.participant, each.option.name)
        if key in attached:
            file, shown = attached[key], [by_uuid[uuid] for uuid in option.uuids]
            again = json.loads(option_to_json(option, shown, each.summary.status))
            wrong = [part for part in again if again[part] != file.get(part)]
            equal[key] = not wrong
            if wrong:
                notes.append(f'{_named(key)} differs from its option file: {", ".join(wrong)}')
    lone = [key for key, file in attached.items() if key not in equal and file.get('uuids')]
    notes += [f'{_named(key)} has an option file, but was not learned again' for key in lone]
    return equal, notes


def software_notes(facts: Mapping[str, str]) -> list[str]:
    """Return a sentence on each package with a version unlike the recorded one."""
    now = software()
    return [
        f'recorded with {name.removesuffix("_version")} {facts[name]}, and this is {now[name]}: '
        'numbers may differ'
        for name in SOFTWARE
        if facts.get(name, UNKNOWN) not in (UNKNOWN, now[name])
    ]


def _named(key: Key) -> str:
    return f'{key[1]!r} by {key[0]}'


def check_games(domain: Domain) -> None:
    """
    Check that plans can be compared in many games.

    :raises EvaluationError: plans of the domain are exact, or it cannot play many games.
    """
    if is_enumerable(domain):
        raise EvaluationError(f'plans in {domain.name} are exact: there is nothing to estimate')


def with_games(
    evaluation: BagEvaluation,
    games: int = GAMES,
    progress: ProgressCallback = ignore_progress,
    jobs: Jobs = 0,
) -> BagEvaluation:
    """
    Compare plans with each participant's options with other policies in many games.

    :param games: number of games per policy, two or more.
    :param progress: callback after each part of the work.
    :param jobs: as in ``all_of``.
    :raises EvaluationError: plans of the domain are exact, or it cannot play many games.
    """
    domain, people, settings = evaluation.domain, evaluation.people, evaluation.settings
    check_games(domain)
    found = {}
    for number, person in enumerate(people):
        options = [each.option for each in evaluation.of(person)]
        plans = (each for each in evaluation.plans.values() if each.participant == person)
        known = next(((each.plan, each.judged) for each in plans), None)

        def report(done: float, total: float, text: str, before: int = number) -> None:
            progress(before + done / total, len(people), text)

        try:
            found[person] = evaluate_games(
                *(domain, options, settings.seed, games, settings.game_steps, report, jobs),
                known=known,
            )
        except PlanError as error:
            raise EvaluationError(f'the games cannot be played: {error}') from error
    return replace(evaluation, games=found)
