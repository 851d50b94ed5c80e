"""``humanopts demo``: the whole graph with a simulated teacher, a bag and a report."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from functools import partial
from pathlib import Path
import sys

from humanopts_env.domains.base import Domain, is_enumerable
from humanopts_env.domains.registry import make_domain
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_learner.planning.request import (
    HUMAN,
    PlanRequest,
    PRIMITIVE,
)
from humanopts_learner.summary import OptionSummary
from humanopts_ros.limits import one_line
from humanopts_teach.bags import BagError
from humanopts_teach.bags.info import TopicRow
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.command_line import LaunchOptions
from humanopts_teach.commands.progress import DemoProgress
from humanopts_teach.commands.session import (
    ARRIVAL_SECONDS,
    new_name,
    Session,
    session,
    setup_from,
    taught_options,
    wait_until_taught,
)
from humanopts_teach.evaluation.bag_evaluation import (
    BagEvaluation,
    evaluate_bag,
    judged_by,
    with_games,
)
from humanopts_teach.evaluation.side_by_side import import_ahead, processes
from humanopts_teach.evaluation.summary import (
    differences,
    Live,
    PlayedEpisodes,
    summary,
    write_json,
)
from humanopts_teach.evaluation.tables import (
    option_row,
    OPTIONS,
    plan_row,
    PLANS,
    SECONDS,
    table,
)
from humanopts_teach.evaluation.text import games_text
from humanopts_teach.launching import LaunchError

EPISODES, LONG_EPISODES = 100, 5  # number of live episodes; the latter for sampled plans
_WATCHED = 0.02  # s between the machine's steps in a terminal


def run_demo(
    name: str,
    launch: LaunchOptions,
    episodes: int | None,
    games: int | None,
    game_steps: int,
    error_rate: float,
) -> int:
    """
    Teach, plan, play, evaluate the bag and report.

    :param name: name of the domain.
    :param episodes: number of live episodes; None: the domain's default.
    :param games: number of games per policy in the comparison; 0: none; None: the domain's
        default.
    :param game_steps: number of game steps for sampled plans; 0: the default.
    :param error_rate: share of the simulated teacher's steps that are wrong.
    :return: exit status, 1 if a check failed.
    """
    domain = make_domain(name, launch.domain_parameters)
    PlanRequest(PRIMITIVE, game_steps=game_steps).resolved(domain, ())  # validates the request
    setup = setup_from(
        name,
        launch,
        evaluated=True,
        directory=Path('runs') / new_name('demo'),
        step_period=_WATCHED if sys.stdout.isatty() else 0.0,
        taught=taught_options(domain),
        teacher_error_rate=error_rate,
        game_steps=game_steps,
    )
    exact = is_enumerable(domain)
    played = episodes or (EPISODES if exact else LONG_EPISODES)
    games = judged_by(domain) if games is None else games
    judged = played if exact else games or judged_by(domain)
    compares = games > 0 and not exact
    with DemoProgress() as progress, processes(int(exact)) as executor:
        with session(setup, progress, new=True) as running:
            progress.stage('teaching')
            import_ahead(['sklearn.tree', evaluate_bag.__module__], executor)
            with ThreadPoolExecutor(1) as background:
                ready = background.submit(_import_report, exact)
                wait_until_taught(running)
                ready.result()
            taught = running.graph.learned()
            live = _plan_and_play(running, domain, taught, played, judged, progress)
        progress.stage('evaluating the bag')
        try:
            bag = open_bag(running.bags[-1])
            evaluation = evaluate_bag(bag, progress.evaluating, judged, executor or 1)
            if compares:
                progress.stage(f'playing {games} games with each')
                evaluation = with_games(evaluation, games, progress.comparing, executor or 1)
        except BagError as error:
            raise LaunchError(f'the recording cannot be evaluated: {error}') from error
        progress.stage('writing the report')
        holds = {
            'path': str(bag.path.relative_to(setup.directory)),
            'messages': bag.n_messages,
            'topics': len(bag.topics),
        }
        from humanopts_teach.report.write import write_evaluation_report

        page = setup.directory / 'report.html'
        restarts = [asdict(end) for end in running.launcher.ends]
        found = {**summary(live, evaluation, holds), 'ended_nodes': restarts}
        write_json(setup.directory / 'summary.json', found)
        topics = write_evaluation_report(page, evaluation, bag, live).topics
    _print_results(live, evaluation)
    print(f'the bag holds {bag.n_messages} messages on {len(bag.topics)} topics')
    print(f'report: {page}')
    problems = _problems(setup.taught, live, evaluation, topics) + running.restarts()
    for problem in problems:
        print(one_line(f'humanopts demo: {problem}'), file=sys.stderr)
    return 1 if problems or running.stop_problems else 0


def _import_report(learns: bool) -> None:
    """
    Import the modules for the report while the teacher teaches.

    :param learns: whether this process relearns the options.
    """
    if learns:
        import sklearn.tree  # noqa: F401
    from humanopts_teach.report import write  # noqa: F401


def _plan_and_play(
    running: Session,
    domain: Domain,
    taught: Sequence[tuple[LearnedOption, OptionSummary]],
    episodes: int,
    judged: int,
    progress: DemoProgress,
) -> Live:
    from humanopts_learner.ros.convert import plan_from_message  # slow to import

    graph, setup = running.graph, running.setup
    progress.stage('planning')
    plans = [
        graph.retry(partial(graph.plan, name, judged, setup.seed, setup.game_steps))
        for name in (HUMAN, PRIMITIVE)
    ]
    progress.stage(f'playing {episodes} episodes')
    played = graph.retry(partial(graph.play, HUMAN, episodes, setup.seed, setup.game_steps))
    graph.wait(graph.all_recorded, ARRIVAL_SECONDS, 'what was shown to be in the newest bag')
    execution = PlayedEpisodes(
        played.episodes,
        played.successes,
        played.fallbacks,
        played.random_moves,
        played.mean_return,
    )
    planned = [plan_row(plan_from_message(result)) for result in plans]
    options = [option_row(summary, each, domain) for each, summary in taught]
    return Live(table(OPTIONS, options), table(PLANS, planned), execution)


def _problems(
    taught: Sequence[str], live: Live, evaluation: BagEvaluation, topics: Sequence[TopicRow]
) -> list[str]:
    """Return a sentence for each failed check of the demo."""
    learned = {*live.options['option_name']}
    found = [f'{name!r} was not taught' for name in taught if name not in learned]
    found += [
        f'{each.option.name!r} is {each.summary.status}'
        for each in evaluation.options
        if not each.summary.learned
    ]
    found += [f'{topic.lost} messages of {topic.name} are lost' for topic in topics if topic.lost]
    found += differences(live, evaluation)
    unfinished = live.execution.episodes - live.execution.successes
    if unfinished and is_enumerable(evaluation.domain):
        found.append(f'{unfinished} episodes ended before the task was done')
    return found


def _print_results(live: Live, evaluation: BagEvaluation) -> None:
    played = live.execution
    for each in evaluation.options:
        shown = each.summary.n_demonstrations
        print(f'{each.option.name}: {shown} demonstrations; {each.summary.status}')
    exact = evaluation.plan_table['exact_mean_return'].dropna()
    for _, row in live.plans.iterrows():
        seconds, name = sum(row[part] for part in SECONDS), row.action_set
        print(
            f'planning with {name}: {row.sweeps} sweeps, {1000 * seconds:.1f} ms, '
            f'mean return {row.mean_return:.2f}'
            + (f', over all starts {exact[name]:.2f}' if name in exact else '')
        )
    moves = f', {played.random_moves} random moves' if played.random_moves else ''
    print(
        f'{played.successes} of {played.episodes} episodes done by running options, '
        f'{played.fallbacks} fallbacks{moves}, mean return {played.mean_return:.2f}'
    )
    for games in evaluation.games.values():
        print('\n'.join(games_text(games)))
