"""``humanopts demo``: the whole graph with a simulated teacher, a bag and a report."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
import sys

from humanopts_env.domains.base import DomainError, is_enumerable
from humanopts_env.domains.capabilities import HasTeachingDefaults
from humanopts_env.domains.registry import make_domain, reference_options
from humanopts_learner.options.files import option_from_json
from humanopts_learner.planning.request import batch_games, HUMAN, PlanError, PRIMITIVE
from humanopts_teach.bags.errors import BagError
from humanopts_teach.bags.reader import Bag, open_bag
from humanopts_teach.commands.ending import CommandError
from humanopts_teach.commands.options import LaunchOptions
from humanopts_teach.commands.progress import DemoProgress
from humanopts_teach.commands.session import (
    check_setup,
    domain_parameters,
    new_name,
    Session,
    session,
    setup_from,
)
from humanopts_teach.evaluation.bag_evaluation import (
    BagEvaluation,
    evaluate_bag,
    judged_by,
    with_games,
)
from humanopts_teach.evaluation.measures import option_block, row_of_result
from humanopts_teach.evaluation.summary import (
    differences,
    Execution,
    Live,
    summary,
    SummaryError,
    write_json,
)
from humanopts_teach.evaluation.text import games_text
from humanopts_teach.launching import LaunchError
from humanopts_teach.launching.processes import Setup
from humanopts_teach.report.recording import TopicRow
from humanopts_teach.report.write import write_evaluation_report

EPISODES, LONG_EPISODES = 100, 5  # to play live; the second where plans are made from samples
_WATCHED = 0.02  # s between steps of the machine, in a terminal
_TEACHING_SECONDS = 600.0  # longest time in which the simulated teacher does nothing


@dataclass(frozen=True)
class Amounts:
    """How much is played."""

    episodes: int  # live, by running options
    judged: int  # episodes that plans are judged by
    games: int  # that each way to play is compared in; 0: no comparison


def run_demo(
    domain: str, launch: LaunchOptions, episodes: int | None, games: int, error_rate: float
) -> int:
    """
    Teach, plan, play, evaluate the bag and report.

    :param episodes: to play live; None: as many as is usual in the domain.
    :param games: that each way to play is compared in; 0: there is no comparison.
    :param error_rate: share of the simulated teacher's steps that are wrong.
    :return: exit status, 1 where something did not hold.
    """
    setup = setup_from(
        domain,
        launch,
        Path('runs') / new_name('demo'),
        evaluated=True,
        step_period=_WATCHED if sys.stdout.isatty() else 0.0,
        taught=_taught_options(domain, launch),
        teacher_error_rate=error_rate,
    )
    amounts = _amounts(setup, episodes, games)
    check_setup(setup, new=True)
    with DemoProgress() as progress:
        with session(setup, launch.namespace, progress) as running:
            live = _teach_plan_play(running, setup, amounts, progress)
        bag, evaluation = _evaluate(setup, amounts, progress)
        progress.stage('writing the report')
        holds = {
            'path': str(setup.bag.relative_to(setup.directory)),
            'messages': bag.n_messages,
            'topics': len(bag.topics),
        }
        try:
            write_json(setup.directory / 'summary.json', summary(live, evaluation, holds))
            page = setup.directory / 'report.html'
            topics = write_evaluation_report(page, evaluation, bag, live).topics
        except SummaryError as error:
            raise CommandError(str(error)) from error
    _print_results(live, evaluation)
    print(f'the bag holds {bag.n_messages} messages on {len(bag.topics)} topics')
    print(f'report: {page}')
    problems = _problems(setup, live, evaluation, topics)
    for problem in problems:
        print(f'humanopts demo: {problem}', file=sys.stderr)
    return 1 if problems or running.unclean else 0


def _amounts(setup: Setup, episodes: int | None, games: int) -> Amounts:
    domain = make_domain(setup.domain, setup.domain_parameters)
    if is_enumerable(domain):
        return Amounts(episodes or EPISODES, episodes or EPISODES, 0)
    return Amounts(episodes or LONG_EPISODES, games or judged_by(domain), games)


def _evaluate(setup: Setup, amounts: Amounts, progress: DemoProgress) -> tuple[Bag, BagEvaluation]:
    """Learn and plan again from the bag alone, and compare what came out in games."""
    progress.stage('evaluating the bag')
    try:
        bag = open_bag(setup.bag)
        evaluation = evaluate_bag(bag, progress.evaluating, amounts.judged)
        if amounts.games:
            progress.stage(f'playing {amounts.games} games with each')
            evaluation = with_games(evaluation, amounts.games, progress.comparing)
        return bag, evaluation
    except BagError as error:
        raise LaunchError(f'the recording cannot be evaluated: {error}') from error


def _taught_options(domain_name: str, launch: LaunchOptions) -> tuple[str, ...]:
    """Return what the simulated teacher teaches: all that it knows, or what the domain says."""
    try:
        domain = make_domain(domain_name, domain_parameters(launch))
        known = tuple(reference_options(domain))
    except DomainError as error:
        raise CommandError(str(error)) from error
    if not is_enumerable(domain):
        try:
            batch_games(domain)
        except PlanError as error:
            raise CommandError(
                f'the demo plans: {error}; teach it yourself: humanopts teach {domain_name}'
            ) from error
    if not known:
        raise CommandError(
            f'{domain_name} has no reference options, which the simulated teacher needs; '
            f'teach it yourself: humanopts teach {domain_name}'
        )
    usual = domain.teaching.options if isinstance(domain, HasTeachingDefaults) else ()
    return usual or known


def _teach_plan_play(
    running: Session, setup: Setup, amounts: Amounts, progress: DemoProgress
) -> Live:
    graph = running.graph
    progress.stage('teaching')
    graph.wait(
        graph.teacher_finished,
        _TEACHING_SECONDS + setup.step_period,
        'the simulated teacher',
        graph.taught_so_far,
    )
    domain = make_domain(setup.domain, setup.domain_parameters)
    references = reference_options(domain)
    options = []
    for model, status in graph.learned():
        option, _ = option_from_json(model)
        options.append(option_block(option, status, domain, references.get(option.name)))
    progress.stage('planning')
    plans = [graph.plan(name, amounts.judged, setup.seed) for name in (HUMAN, PRIMITIVE)]
    progress.stage(f'playing {amounts.episodes} episodes')
    played = graph.play(HUMAN, amounts.episodes, setup.seed)
    execution = Execution(
        episodes=played.episodes,
        successes=played.successes,
        fallbacks=played.fallbacks,
        mean_return=played.mean_return,
    )
    return Live(tuple(options), tuple(row_of_result(plan) for plan in plans), execution)


def _problems(
    setup: Setup, live: Live, evaluation: BagEvaluation, topics: Sequence[TopicRow]
) -> list[str]:
    """Return a sentence for each check of the demo that failed."""
    learned = {block.name for block in live.options}
    found = [f'{name!r} was not learned' for name in setup.taught if name not in learned]
    found += [
        f'the criteria of {b.name!r} are not met' for b in live.options if not b.criteria_met
    ]
    found += [f'{topic.lost} messages of {topic.name} are lost' for topic in topics if topic.lost]
    found += differences(live, evaluation)
    undone = live.execution.episodes - live.execution.successes
    if undone and is_enumerable(evaluation.domain):
        found.append(f'{undone} episodes ended with the task not done')
    return found


def _print_results(live: Live, evaluation: BagEvaluation) -> None:
    played = live.execution
    for block in live.options:
        met = 'met' if block.criteria_met else 'not met'
        print(f'{block.name}: {block.n_demonstrations} demonstrations, criteria {met}')
    for row in live.planning:
        print(
            f'planning with {row.action_set}: {row.sweeps} sweeps, {1000 * row.seconds:.1f} ms, '
            f'mean return {row.mean_return:.2f}'
        )
    print(
        f'{played.successes} of {played.episodes} episodes done by running options, '
        f'{played.fallbacks} fallbacks, mean return {played.mean_return:.2f}'
    )
    for games in evaluation.games.values():
        print('\n'.join(games_text(games)))
