"""Writing a report as one self-contained HTML file."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from humanopts_env.domains.base import is_enumerable
from humanopts_env.domains.registry import reference_options
from humanopts_learner.demonstrations import METHODS
from humanopts_learner.planning.exact_plan import ExactPlan
from humanopts_teach.bags.info import summarise, TopicRow
from humanopts_teach.bags.provenance import OWN_VERSION, software, UNKNOWN
from humanopts_teach.bags.reader import Bag
from humanopts_teach.evaluation.bag_evaluation import BagEvaluation
from humanopts_teach.evaluation.summary import Live, write_text
from humanopts_teach.evaluation.text import limits_text, REPRODUCED
from humanopts_teach.report.boards import board_figures
from humanopts_teach.report.charts import (
    games_figures,
    learning_curves,
    planning_figures,
    sweep_figure,
)
from humanopts_teach.report.episode import episode_strip, Frame, read_last_episode
from humanopts_teach.report.findings import findings, plans_by_name, plans_shown
from humanopts_teach.report.pages import render
from humanopts_teach.report.people import (
    judged_runs,
    shown_demonstrations,
    shown_return,
    teachers,
    wrong_ends,
)
from humanopts_teach.report.rules import option_rules

MEASURES = (  # column of ``OPTIONS``, its label, and whether it is a share
    ('n_demonstrations', 'demonstrations', False),
    ('n_questions', 'answers about its runs', False),
    ('exam_right', 'right runs in the exam', False),
    ('exam_runs', 'runs in the exam', False),
    ('mean_return_demonstrations', 'mean return of the demonstrations', False),
    ('mean_return_policy', 'mean return of the policy, same starts', False),
    ('success', 'success: starts that lead to an end like a demonstrated one', True),
    ('initiation', 'initiation: held-out balanced error', False),
    ('termination', 'termination: held-out demonstrations that end elsewhere', True),
    ('policy_accuracy', 'policy accuracy', True),
    ('classification_accuracy_initiation', 'classification accuracy of I', True),
    ('classification_accuracy_termination', 'classification accuracy of β', True),
)


@dataclass(frozen=True)
class ReportData:
    """The contents of a report; empty parts are omitted."""

    title: str
    evaluation: BagEvaluation
    live: Live | None = None  # numbers from the running graph
    frames: Sequence[Frame] = ()
    topics: Sequence[TopicRow] = ()
    provenance: Mapping[str, str] = field(default_factory=dict)  # texts by name, such as versions


def write_evaluation_report(
    path: Path, evaluation: BagEvaluation, bag: Bag | None = None, live: Live | None = None
) -> ReportData:
    """
    Write a self-contained report.

    :param bag: source of the recording data and the last episode; None: unknown.
    :param live: numbers from the running graph; None: unknown.
    :return: contents of the report.
    :raises SummaryError: the file cannot be written.
    :raises StateError: a recorded state is not a state of the domain.
    """
    how = 'evaluated from a bag' if live is None else 'taught, planned, played'
    title = f'{evaluation.domain.name}: {how}'
    data = ReportData(title, evaluation, live)
    if bag is not None:
        holds = f'{bag.path.name}: {bag.n_messages:,} messages on {len(bag.topics)} topics'
        frames, topics = read_last_episode(bag), summarise(bag).topics
        data = ReportData(title, evaluation, live, frames, topics, {'bag': holds})
    write_text(path, render_report(data))
    return data


def render_report(data: ReportData) -> str:
    """
    Return the HTML of a report.

    :raises StateError: a state of the episode is not a state of the domain.
    """
    evaluation, live = data.evaluation, data.live
    plans = plans_shown(evaluation, live)
    episode = episode_strip(evaluation.domain, data.frames)  # drawn first, since it can fail
    exact = {
        name: found.plan
        for name, found in evaluation.plans.items()
        if isinstance(found.plan, ExactPlan)
    }
    values = {
        'title': data.title,
        'findings': findings(evaluation, live, data.topics),
        'games': [
            (person, games, games_figures(games, f'games-{index}'))
            for index, (person, games) in enumerate(evaluation.games.items())
        ],
        'sweeps': sweep_figure(exact, 'sweeps'),
        'sampled': bool(plans['game_steps'].any()),
        'options': [
            (
                option,
                learning_curves(option, f'option-{index}'),
                option_rules(option.option, evaluation.domain),
            )
            for index, option in enumerate(evaluation.options)
        ],
        'demonstrations': shown_demonstrations(evaluation),
        'judged_runs': judged_runs(evaluation),
        'wrong_ends': wrong_ends(evaluation),
        'teachers': teachers(evaluation),
        'shown': [shown_return(evaluation, each) for each in evaluation.options],
        'references': reference_options(evaluation.domain),
        'exact_accuracy': is_enumerable(evaluation.domain),
        'live': None if live is None else {o.option_name: o for o in live.options.itertuples()},
        'measures': MEASURES,
        'methods': METHODS,
        'reproduced': REPRODUCED,
        'limits_text': limits_text,
        'boards': board_figures(exact, 'board'),
        'planning': plans_by_name(plans),
        'evaluation': evaluation,
        'planning_figures': planning_figures(plans, 'planning'),
        'episode': episode,
        'topics': data.topics,
        'provenance': data.provenance,
        'versions': _versions(),
    }
    return render('humanopts_teach.report', 'report.html', values)


def _versions() -> list[str]:
    """Return the known software versions."""
    now, names = software(), ('Python', 'NumPy', 'scikit-learn')
    versions = {**{name: now[name.lower()] for name in names}, 'humanopts': now[OWN_VERSION]}
    return [f'{name} {version}' for name, version in versions.items() if version != UNKNOWN]
