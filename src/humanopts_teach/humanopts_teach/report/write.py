"""Writing a report: one HTML file with everything in it."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
import platform
from typing import Any

from humanopts_learner.planning.plan import Plan
from humanopts_teach.evaluation.bag_evaluation import BagEvaluation, OptionEvaluation
from humanopts_teach.evaluation.summary import write_text
from humanopts_teach.evaluation.text import REPRODUCED
from humanopts_teach.report.boards import board_figures
from humanopts_teach.report.charts import games_figures, learning_curves, planning_figures
from humanopts_teach.report.data import Frame, ReportData, TopicRow
from humanopts_teach.report.film import filmstrip
from humanopts_teach.report.pages import template
from humanopts_teach.report.rules import option_rules
from humanopts_teach.report.sweeps import sweep_report
from humanopts_teach.report.words import (
    DASH,
    duration,
    findings,
    games_findings,
    number,
    percent,
    planning_rows,
)
from markupsafe import Markup

MEASURES = (  # field of OptionBlock, how it reads, whether it is a share
    ('n_demonstrations', 'demonstrations', False),
    ('mean_return_demonstrations', 'mean return of the demonstrations', False),
    ('mean_return_policy', 'mean return of the learned policy, same starts', False),
    ('cv_error_initiation', 'initiation: held-out balanced error', False),
    ('cv_error_termination', 'termination: held-out balanced error', False),
    ('policy_accuracy', 'policy accuracy', True),
    ('classification_accuracy_initiation', 'classification accuracy of I', True),
    ('classification_accuracy_termination', 'classification accuracy of β', True),
)


def write_report(path: Path, data: ReportData) -> None:
    """
    Write a report that needs no other file and no network.

    :raises SummaryError: the file cannot be written.
    :raises StateError: a frame is not of the domain.
    """
    write_text(path, render_report(data))


def write_evaluation_report(
    path: Path,
    evaluation: BagEvaluation,
    frames: Sequence[Frame] = (),
    topics: Sequence[TopicRow] = (),
    provenance: Mapping[str, str] | None = None,
) -> None:
    """
    Write what a bag alone gives; errors as ``write_report``.

    :param provenance: what is to be known of the bag and the programs, by name.
    """
    title = f'{evaluation.domain.name}: evaluated from a bag'
    write_report(path, ReportData(title, evaluation, None, frames, topics, provenance or {}))


def render_report(data: ReportData) -> str:
    """Return the page."""
    evaluation = data.evaluation
    planning = planning_rows(data)
    exact = {
        name: p.plan
        for name, p in zip(evaluation.plan_names, evaluation.plans)
        if isinstance(p.plan, Plan)
    }
    values: dict[str, Any] = {
        'title': data.title,
        'findings': findings(
            data, [f for g in evaluation.games.values() for f in games_findings(g)]
        ),
        'games': [
            (person, games, games_figures(games, f'games-{place}'))
            for place, (person, games) in enumerate(evaluation.games.items())
        ],
        'sweeps': sweep_report(exact, 'sweeps'),
        'sampled': any(row.game_steps for row in planning.values()),
        'options': [
            (
                option,
                _seconds(option),
                learning_curves(option.curve, f'option-{place}', option.block.name),
                option_rules(option.option, evaluation.domain),
            )
            for place, option in enumerate(evaluation.options)
        ],
        'live': {block.name: block for block in data.summary.options} if data.summary else {},
        'has_live': data.summary is not None,
        'measures': MEASURES,
        'reproduced': REPRODUCED,
        'boards': board_figures(exact, 'board'),
        'planning': planning,
        'teaching_cost': _teaching_cost(evaluation),
        'planning_figures': planning_figures(planning, 'planning'),
        'film': filmstrip(evaluation.domain, data.frames),
        'topics': sorted(data.topics, key=lambda topic: topic.name),
        'provenance': _provenance(data),
        'svg': Markup,
        'number': number,
        'percent': percent,
        'duration': duration,
    }
    return template('humanopts_teach.report', 'report.html').render(values)


def _seconds(option: OptionEvaluation) -> float:
    return option.curve[-1].seconds if option.curve else 0.0


def _teaching_cost(evaluation: BagEvaluation) -> dict[str, str]:
    """Return what it took to get the options of each plan, by what the plan is called."""
    cost = {}
    for name, plan in zip(evaluation.plan_names, evaluation.plans):
        taught = [o for o in evaluation.options if o.participant == plan.participant]
        shown = sum(option.block.n_demonstrations for option in taught)
        cost[name] = f'{shown} in {duration(sum(map(_seconds, taught)))}' if taught else DASH
    return cost


def _provenance(data: ReportData) -> dict[str, str]:
    """Return what a reader needs to get the same numbers again."""
    settings = data.evaluation.settings
    rate = settings.teacher_error_rate
    parameters = ', '.join(f'{k} {v}' for k, v in data.evaluation.domain.parameters.items())
    facts = {
        'domain': f'{data.evaluation.domain.name} ({parameters})',
        'seed': str(settings.seed),
        'start states chosen by': f'{settings.strategy}, at most {settings.budget} for an option',
        'criteria': (
            f'return at most {settings.thresholds.return_delta:g} reward units short, '
            f'initiation at most {settings.thresholds.initiation_error:g}, '
            f'termination at most {settings.thresholds.termination_error:g}'
        ),
        'teacher': 'a person' if rate is None else f'simulated, {percent(rate)} of steps wrong',
    }
    if data.summary is not None:
        bag = data.summary.bag
        facts['bag'] = f'{bag.path}: {bag.messages:,} messages on {bag.topics} topics'
    return {**facts, 'evaluated with': _versions(), **data.provenance}


def _versions() -> str:
    packages = {'NumPy': 'numpy', 'scikit-learn': 'scikit-learn', 'humanopts': 'humanopts_teach'}
    found = [f'Python {platform.python_version()}']
    for name, package in packages.items():
        with suppress(PackageNotFoundError):
            found.append(f'{name} {version(package)}')
    return ', '.join(found)
