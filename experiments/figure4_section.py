"""Figure 4 in the report: learning curves by action set."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments import figure4, paper
from experiments.bands import Band, band
from experiments.cells import code_version
from experiments.figure4_pictures import draw_all, draw_papers, SIZE
from experiments.sections import (
    agreement,
    Comparison,
    Picture,
    Section,
    Table,
    Value,
    Verdict,
)
from experiments.study import Experiment, Study

TITLE = 'Figure 4: steps per episode of Q-learning'
METHODS = {'smdp': 'SMDP Q-learning', 'intra-option': 'intra-option Q-learning'}


@dataclass(frozen=True)
class Curve:
    """How one action set was learned with."""

    method: str
    name: str  # of the action set
    steps: NDArray[np.float64]  # (P, E) mean of the learners of each person or extraction
    rates: tuple[tuple[float, float], ...]  # (P,) learning rate, share of exploring decisions
    options: tuple[int, ...]  # (P,) how many

    def band(self) -> Band:
        """Return mean and band, episode by episode."""
        return band(self.steps, least=1.0)

    def total(self) -> tuple[float, float, float]:
        """Return the steps of all episodes: mean, low, high."""
        found = band(self.steps.sum(axis=1, keepdims=True), least=0.0)
        return float(found.mean[0]), float(found.low[0]), float(found.high[0])


def present(study: Study, results: Mapping[str, Any]) -> Section:
    """Return what the report says of the cells that have a result."""
    curves = _gather(study, results)
    text = (
        f'Taxi, {study.seeds} learners for each person, extraction or repetition, from values of '
        f'0, in {paper.EPISODES} episodes that are cut off after {figure4.LIMIT} steps. For each, '
        f'{figure4.TRIED} pairs of learning rate and share of exploring decisions were tried, '
        'the same for every action set; what is shown is learned anew with the best of them. '
        'The steps are primitive ones. Human options are those of whole lessons with the '
        'criteria; automatic ones are those of figure 3. Lines are means over people, extractions '
        "or repetitions, bands their 95 % confidence intervals by Student's t."
    )
    mixtures = (
        'Where every step costs 1, values of 0 are optimistic: what was not tried yet looks '
        'better than what was. So learners that have primitive actions beside options turn to '
        'them in state after state until all are tried: their episodes get longer before they '
        'get shorter. Options alone leave less to try. The paper has no mixtures.'
    )
    return Section(
        figure4.NAME,
        TITLE,
        [text, mixtures],
        _comparisons(curves),
        _pictures(curves),
        [_summary(curves), _curve_table(curves)],
        {'code': code_version(), 'limit': figure4.LIMIT, 'rates tried': figure4.TRIED},
    )


EXPERIMENT = Experiment(figure4.NAME, TITLE, figure4.cells, present)


def _gather(study: Study, results: Mapping[str, Any]) -> list[Curve]:
    found: dict[tuple[str, str], list[Any]] = {}
    for cell in figure4.cells(study):
        if cell.key in results:
            key = cell.parameters['method'], cell.parameters['set']
            found.setdefault(key, []).append(results[cell.key])
    return [
        Curve(
            method,
            name,
            np.array([one['steps'] for one in members]),
            tuple((one['learning_rate'], one['explore']) for one in members),
            tuple(len(one['options']) for one in members),
        )
        for (method, name), members in found.items()
    ]


def _comparisons(curves: Sequence[Curve]) -> list[Comparison]:
    found = []
    for method, called in METHODS.items():
        mine = {curve.name: curve for curve in curves if curve.method == method}
        if 'human' not in mine or 'automatic' not in mine:
            continue
        totals = {name: mine[name].total() for name in mine}
        text = f'{called}, steps in all {paper.EPISODES} episodes: ' + '; '.join(
            f'{name} {mean:,.0f}' for name, (mean, _, _) in totals.items()
        )
        said = paper.FIGURE_4[0]
        faster = totals['human'][0] < totals['automatic'][0]
        found.append(Comparison(said.text, said.where, f'{text}.', agreement(faster)))
    if curves:
        found += _mixtures(curves)
        said = paper.FIGURE_4[1]
        first = '; '.join(
            f'{curve.name} {curve.steps[:, 0].mean():.0f}'
            for curve in curves
            if curve.method == 'smdp'
        )
        text = (
            f'First episode, SMDP Q-learning: {first}. The paper gives neither rates nor a limit '
            'of steps.'
        )
        found.append(Comparison(said.text, said.where, text, Verdict.NOT_COMPARABLE))
    return found


def _mixtures(curves: Sequence[Curve]) -> list[Comparison]:
    """Tell how options do beside primitive actions, of which the paper says nothing."""
    found = []
    for kind in ('human', 'automatic'):
        pairs = {
            METHODS[curve.method]: curve.steps.mean(axis=0)
            for curve in curves
            if curve.name == f'{kind} + primitive'
        }
        if pairs:
            told = '; '.join(
                f'{called}: {steps[:10].mean():.0f} steps in the first 10 episodes, '
                f'{steps[-10:].mean():.0f} in the last 10'
                for called, steps in pairs.items()
            )
            said = f'Learning with {kind} options and primitive actions together is not shown.'
            found.append(Comparison(said, 'figure 4', f'{told}.', Verdict.NOT_COMPARABLE))
    return found


def _pictures(curves: Sequence[Curve]) -> list[Picture]:
    pictures = []
    for method, called in METHODS.items():
        bands = {curve.name: curve.band() for curve in curves if curve.method == method}
        if bands:
            label = f'Steps per episode of {called} in Taxi by action set'
            for suffix, draw, axis in (
                ('-paper', draw_papers, "on the paper's axis"),
                ('', draw_all, 'all action sets'),
            ):
                drawn, caption = partial(draw, bands, called), f'Taxi, {called}, {axis}'
                name = f'fig4-{method}{suffix}'
                pictures.append(Picture(name, f'{label}, {axis}', SIZE, drawn, caption))
    return pictures


def _summary(curves: Sequence[Curve]) -> Table:
    rows: list[list[Value]] = []
    for curve in curves:
        mean = curve.steps.mean(axis=0)
        rates = np.array(curve.rates).mean(axis=0)
        limits = [_number(value) for value in curve.total()]
        ends = [float(mean[:10].mean()), float(mean[-10:].mean())]
        options = float(np.mean(curve.options))
        called = METHODS[curve.method]
        rows.append([called, curve.name, len(curve.steps), options, *limits, *ends, *rates])
    columns = ['method', 'action set', 'count', 'options', 'steps in all', 'low', 'high']
    columns += ['first 10 episodes', 'last 10', 'learning rate', 'exploring']
    return Table('fig4-summary', 'Steps while learning', columns, rows)


def _curve_table(curves: Sequence[Curve]) -> Table:
    """Return exactly what is drawn."""
    rows: list[list[Value]] = []
    for curve in curves:
        found = curve.band()
        for episode, values in enumerate(zip(found.mean, found.low, found.high), start=1):
            numbers = [_number(value) for value in values]
            rows.append([METHODS[curve.method], curve.name, episode, len(curve.steps), *numbers])
    columns = ['method', 'action set', 'episode', 'count', 'mean', 'low', 'high']
    return Table('fig4-curves', 'The curves', columns, rows, shown=False)


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
