"""
Figure 3: options found without a person in Taxi (section 7.3).

By the algorithm of Stolle and Precup (2002), see ``humanopts_learner.automatic``. One cell is one
extraction, from random tasks of its own.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from humanopts_env.domains.taxi import Taxi
from humanopts_env.domains.taxi_reference import reference_options
from humanopts_learner.automatic.extract import AutomaticOption, find_options
from humanopts_learner.automatic.ground import ground_of
from humanopts_teach.experiments import paper
from humanopts_teach.experiments.cells import Cell
from humanopts_teach.experiments.sections import (
    agreement,
    Comparison,
    Paint,
    Picture,
    Section,
    Table,
    Value,
)
from humanopts_teach.experiments.study import Experiment, Study
from humanopts_teach.report.automatic_figure import draw_visits, visit_map, VisitMap
from humanopts_teach.report.figures import Drawing
import numpy as np

NAME, VERSION = 'fig3', 1
TITLE = 'Figure 3: automatic options'
CENTRE = 'go to cell 2,2'  # of the 5 x 5 grid


def cells(study: Study) -> list[Cell]:
    """Return one cell for each seed."""
    seeds = range(study.seed, study.seed + study.seeds)
    return [Cell(NAME, VERSION, {'seed': seed}, extract, 2.0) for seed in seeds]


def extract(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Find the options of Taxi; return them in the order of finding, and the cost."""
    domain = Taxi()
    found = find_options(domain, parameters['seed'])
    reached = found.ground.reached & ~domain.over()
    return {
        'options': [_option(option, reached) for option in found.options],
        'visits': found.visits.tolist(),
        'seconds': found.seconds,
        'game_steps': found.game_steps,
        'episodes': found.episodes,
        'solved': found.solved,
    }


def _option(option: AutomaticOption, reached: Any) -> dict[str, Any]:
    return {
        'name': option.name,
        'cell': int(option.target.cell),
        'event': option.target.event,
        'visits': int(option.target.visits),
        'can_start': float(option.tables.initiation[reached].mean()),
        'reaches': float(option.reaches),
    }


def present(study: Study, results: Mapping[str, Any]) -> Section:
    """Return what the report says of the cells that have a result."""
    found = {
        cell.parameters['seed']: results[cell.key] for cell in cells(study) if cell.key in results
    }
    text = (
        'Random tasks are learned by Q-learning; where greedy runs pass most often are '
        'bottlenecks, taken one by one, and each becomes the target of an option. The map shows '
        'the visits of the first seed, with the options numbered in the order in which they were '
        'found.'
    )
    members = list(found.values())
    return Section(
        NAME,
        TITLE,
        [text],
        _comparisons(members) if members else [],
        _pictures(members[0]) if members else [],
        [_option_table(found), _seed_table(found)],
        {'version': VERSION},
    )


EXPERIMENT = Experiment(NAME, TITLE, cells, present)


def _events(one: Mapping[str, Any]) -> Counter[str]:
    return Counter(option['event'] for option in one['options'])


def _comparisons(found: Sequence[Mapping[str, Any]]) -> list[Comparison]:
    alike = sum(_events(one) == paper.AUTOMATIC for one in found)
    centre = sum(any(o['name'] == CENTRE for o in one['options']) for one in found)
    others = Counter(o['name'] for one in found for o in one['options'] if not o['event'])
    cells_found = ', '.join(f'{name} ({count})' for name, count in others.most_common())
    kinds = f'{alike} of {len(found)} extractions found four pickups, four dropoffs and one cell.'
    where = f'The centre in {centre} of {len(found)} extractions. Cells: {cells_found or "none"}.'
    counts = [len(one['options']) for one in found]
    actions = len(Taxi().actions)
    more = f'{np.mean(counts):.1f} options on average, {actions} primitive actions.'
    most = sum(count - actions == 3 for count in counts)
    return [
        _said(0, kinds, 2 * alike > len(found)),
        _said(1, where, 2 * centre > len(found)),
        _said(2, more, 2 * most > len(found)),
        _said(3, *_coverage(found)),
    ]


def _said(number: int, found: str, agrees: bool) -> Comparison:
    statement = paper.FIGURE_3[number]
    return Comparison(statement.text, statement.where, found, agreement(agrees))


def _coverage(found: Sequence[Mapping[str, Any]]) -> tuple[str, bool]:
    """Compare in how many states one option can start, human ones as an expert means them."""
    domain = Taxi()
    meant = reference_options(domain)
    reached = ground_of(domain).reached & ~domain.over()
    human = [float(meant[name].initiation[reached].mean()) for name in paper.TAUGHT['taxi']]
    automatic = [option['can_start'] for one in found for option in one['options']]
    text = (
        f'One automatic option can start in {np.mean(automatic):.0%} of states on average, one '
        f'human option, as an expert means it, in {np.mean(human):.0%}.'
    )
    return text, float(np.mean(human)) > float(np.mean(automatic))


def _pictures(first: Mapping[str, Any]) -> list[Picture]:
    domain = Taxi()
    targets = [option['cell'] for option in first['options']]
    seen = visit_map(domain, ground_of(domain), np.array(first['visits']), targets)
    if seen is None:
        return []
    names = '; '.join(f'{n}: {o["name"]}' for n, o in enumerate(first['options'], start=1))
    label = 'Visits of greedy runs in Taxi, with the targets of automatic options'
    return [Picture('fig3-automatic', label, seen.size, partial(_draw, seen), names)]


def _draw(seen: VisitMap, work: Drawing, paint: Paint) -> None:
    draw_visits(work, seen)


def _option_table(found: Mapping[int, Mapping[str, Any]]) -> Table:
    fields = ('name', 'visits', 'can_start', 'reaches')
    rows: list[list[Value]] = [
        [seed, number, *(option[name] for name in fields)]
        for seed, one in found.items()
        for number, option in enumerate(one['options'], start=1)
    ]
    columns = ['seed', 'number', 'option', 'visits', 'share of states where it can start']
    columns += ['share of these from which it came to its target']
    return Table('fig3-options', 'The options', columns, rows, shown=False)


def _seed_table(found: Mapping[int, Mapping[str, Any]]) -> Table:
    rows: list[list[Value]] = []
    for seed, one in found.items():
        events, reaches = _events(one), [option['reaches'] for option in one['options']]
        counts = [len(one['options']), *(events.get(event, 0) for event in paper.AUTOMATIC)]
        cost = [one['seconds'], one['game_steps'], one['episodes'], one['solved']]
        rows.append([seed, *counts, float(np.mean(reaches)), *cost])
    columns = ['seed', 'options', 'pickups', 'dropoffs', 'cells', 'share that comes to the target']
    columns += ['seconds', 'game steps', 'episodes', 'share of runs that came to their goals']
    return Table('fig3-extractions', 'Each extraction, and what it cost', columns, rows)
