"""``humanopts demo``: the whole graph with a simulated teacher, a bag and a report."""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
import sys
from typing import Any

from humanopts_env.domains.base import DomainError, is_enumerable
from humanopts_env.domains.registry import make_domain, reference_options
from humanopts_learner.options.files import option_from_json
from humanopts_learner.planning.plan import HUMAN, PRIMITIVE
from humanopts_teach.bags.errors import BagError
from humanopts_teach.bags.reader import Bag, open_bag
from humanopts_teach.commands.errors import CommandError
from humanopts_teach.commands.progress import DemoProgress
from humanopts_teach.commands.session import check_setup, Session, session
from humanopts_teach.commands.setup import new_name, parameters_from, setup_from
from humanopts_teach.evaluation.bag_evaluation import BagEvaluation, evaluate_bag, EvaluationError
from humanopts_teach.evaluation.options_block import differences, option_block, OptionBlock
from humanopts_teach.evaluation.planning import PlanningRow, row_of_result
from humanopts_teach.evaluation.summary import (
    BagFacts,
    Execution,
    Summary,
    SummaryError,
    write_json,
)
from humanopts_teach.launching.launcher import LaunchError
from humanopts_teach.launching.processes import Setup
from humanopts_teach.report.bag_parts import bag_parts
from humanopts_teach.report.data import ReportData, TopicRow
from humanopts_teach.report.write import write_report

# What the paper's participants were asked to teach (section 7).
TAUGHT = {'taxi': ('go to passenger and pickup', 'go to destination and dropoff')}
_TEACHING_SECONDS = 600.0


@dataclass(frozen=True)
class Live:
    """What was seen while the graph ran."""

    options: tuple[OptionBlock, ...]
    planning: tuple[PlanningRow, ...]
    execution: Execution


def run(arguments: argparse.Namespace) -> int:
    """Teach, plan, play, evaluate the bag and report; status 1 when something did not hold."""
    setup = setup_from(
        arguments,
        Path('runs') / new_name('demo'),
        taught=_taught_options(arguments),
        teacher_error_rate=arguments.error_rate,
    )
    check_setup(setup, new=True)
    with DemoProgress() as progress:
        with session(setup, arguments.namespace, progress) as running:
            live = _teach_plan_play(running, setup, arguments.episodes, progress)
        progress.stage('evaluating the bag')
        bag, evaluation = _evaluate(setup, progress)
        summary = _summarise(setup, live, evaluation, bag)
        progress.stage('writing the report')
        parts = bag_parts(bag)
        title = f'{setup.domain}: taught, planned, played'
        data = ReportData(title, evaluation, summary, parts.frames, parts.topics)
        try:
            write_json(setup.directory / 'summary.json', summary.to_dict())
            write_report(setup.directory / 'report.html', data)
        except SummaryError as error:
            raise CommandError(str(error)) from error
    return _conclude(setup, summary, _problems(setup, summary, parts.topics))


def _evaluate(setup: Setup, progress: DemoProgress) -> tuple[Bag, BagEvaluation]:
    try:
        bag = open_bag(setup.bag)
        return bag, evaluate_bag(bag, progress.offline)
    except (BagError, EvaluationError) as error:
        raise LaunchError(f'the recording cannot be evaluated: {error}') from error


def _taught_options(arguments: argparse.Namespace) -> tuple[str, ...]:
    """Return what the simulated teacher teaches: all that it knows, where nothing else is said."""
    try:
        domain = make_domain(arguments.domain, parameters_from(arguments))
        known = tuple(reference_options(domain))
    except DomainError as error:
        raise CommandError(str(error)) from error
    if not is_enumerable(domain):
        raise CommandError(
            f'the demo plans, and the states of {arguments.domain} cannot all be listed; '
            f'teach it yourself: humanopts teach {arguments.domain}'
        )
    if not known:
        raise CommandError(
            f'{arguments.domain} has no reference options, which the simulated teacher needs; '
            f'teach it yourself: humanopts teach {arguments.domain}'
        )
    return TAUGHT.get(arguments.domain, known)


def _teach_plan_play(
    running: Session, setup: Setup, episodes: int, progress: DemoProgress
) -> Live:
    conductor = running.conductor
    progress.stage('teaching')
    conductor.wait(conductor.teacher_finished, _TEACHING_SECONDS, 'the simulated teacher')
    options = _blocks(setup, conductor.learned())
    progress.stage('planning')
    plans = [conductor.plan(name, episodes, setup.seed) for name in (HUMAN, PRIMITIVE)]
    progress.stage(f'playing {episodes} episodes')
    played = conductor.play(HUMAN, episodes, setup.seed)
    execution = Execution(
        episodes=played.episodes,
        successes=played.successes,
        fallbacks=played.fallbacks,
        mean_return=played.mean_return,
    )
    return Live(options, tuple(row_of_result(plan) for plan in plans), execution)


def _blocks(setup: Setup, learned: Sequence[tuple[str, Any]]) -> tuple[OptionBlock, ...]:
    domain = make_domain(setup.domain, setup.domain_parameters)
    references = reference_options(domain)
    blocks = []
    for model, status in learned:
        option, _ = option_from_json(model)
        blocks.append(option_block(option, status, domain, references.get(option.name)))
    return tuple(blocks)


def _summarise(setup: Setup, live: Live, evaluation: BagEvaluation, bag: Bag) -> Summary:
    return Summary(
        domain=setup.domain,
        settings=evaluation.settings,
        options=live.options,
        planning=live.planning,
        execution=live.execution,
        bag=BagFacts(
            path=str(setup.bag.relative_to(setup.directory)),
            messages=bag.n_messages,
            topics=len(bag.topics),
        ),
        offline=evaluation.blocks,
    )


def _problems(setup: Setup, summary: Summary, topics: Sequence[TopicRow]) -> list[str]:
    """Return in words what a demo promises and this one did not keep."""
    learned = {block.name for block in summary.options}
    found = [f'{name!r} was not learned' for name in setup.taught if name not in learned]
    found += [
        f'the criteria of {b.name!r} are not met' for b in summary.options if not b.criteria_met
    ]
    found += [f'{topic.lost} messages of {topic.name} are lost' for topic in topics if topic.lost]
    found += differences(summary.options, summary.offline)
    undelivered = summary.execution.episodes - summary.execution.successes
    if undelivered:
        found.append(f'{undelivered} episodes ended with the task not done')
    return found


def _conclude(setup: Setup, summary: Summary, problems: Sequence[str]) -> int:
    played = summary.execution
    for block in summary.options:
        met = 'met' if block.criteria_met else 'not met'
        print(f'{block.name}: {block.n_demonstrations} demonstrations, criteria {met}')
    for row in summary.planning:
        seconds = row.table_seconds + row.model_seconds + row.sweep_seconds
        print(
            f'planning with {row.action_set}: {row.sweeps} sweeps, {1000 * seconds:.1f} ms, '
            f'mean return {row.mean_return:.2f}'
        )
    print(
        f'{played.successes} of {played.episodes} episodes done by running options, '
        f'{played.fallbacks} fallbacks, mean return {played.mean_return:.2f}'
    )
    print(f'the bag holds {summary.bag.messages} messages on {summary.bag.topics} topics')
    print(f'report: {setup.directory / "report.html"}')
    for problem in problems:
        print(f'humanopts demo: {problem}', file=sys.stderr)
    return 1 if problems else 0
