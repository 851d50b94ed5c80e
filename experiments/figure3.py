"""
Figure 3: options found without a person, in Taxi (section 7.3) and in the maze of Pac-Man.

By the algorithm of Stolle and Precup (2002), see ``humanopts_learner.automatic``. One cell is one
extraction, from random tasks of its own.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from humanopts_env.domains.registry import make_domain
from humanopts_env.domains.taxi import Taxi
from humanopts_env.domains.taxi_reference import reference_options
from humanopts_learner.automatic.extract import AutomaticOption, find_options
from humanopts_learner.automatic.search_space import search_space
from humanopts_teach.report.automatic_figure import draw_visits, visit_map, VisitMap
from humanopts_teach.report.figures import Drawing
import numpy as np

from experiments import paper
from experiments.cells import Cell, code_version
from experiments.sections import (
    agreement,
    Comparison,
    Paint,
    Picture,
    Section,
    Table,
    Value,
)
from experiments.study import Experiment, Study

NAME = 'fig3'
DOMAINS = {'taxi': 'Taxi', 'pacman': 'Pac-Man'}
TITLE = 'Figure 3: automatic options'
CENTRE = 'go to cell 2,2'  # of the 5 x 5 grid
MIDDLE = 12  # index of that cell
PAPERS = (*(f'{event} at {name}' for event in ('pickup', 'dropoff') for name in 'RGYB'), CENTRE)
Found = Mapping[str, Mapping[int, Mapping[str, Any]]]  # by domain and seed


def cells(study: Study) -> list[Cell]:
    """Return one cell for each domain and seed."""
    seeds = range(study.seed, study.seed + study.seeds)
    return [
        Cell(NAME, {'domain': domain, 'seed': seed}, extract, 2.0)
        for domain in DOMAINS
        for seed in seeds
    ]


def extract(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Find the options of a domain; return them in the order of finding, and the cost."""
    found = find_options(make_domain(parameters['domain']), parameters['seed'])
    reached = found.space.open
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
    found: dict[str, dict[int, Any]] = {}
    for cell in cells(study):
        if cell.key in results:
            of_domain = found.setdefault(cell.parameters['domain'], {})
            of_domain[cell.parameters['seed']] = results[cell.key]
    text = (
        'Random tasks are learned by Q-learning; where greedy runs pass most often are '
        'bottlenecks, taken one by one, and each becomes the target of an option. The maps show '
        'the visits of the first seed, with the options numbered in the order in which they were '
        'found. In Pac-Man the tasks lead from cell to cell of the maze, without ghosts; the '
        'paper does not say what was found there.'
    )
    members = list(found.get('taxi', {}).values())
    return Section(
        NAME,
        TITLE,
        [text],
        _comparisons(members) if members else [],
        [_picture(domain, next(iter(of_domain.values()))) for domain, of_domain in found.items()],
        [
            *(_found_table(domain, of_domain) for domain, of_domain in found.items()),
            _option_table(found),
            _seed_table(found),
        ],
        {'code': code_version()},
    )


EXPERIMENT = Experiment(NAME, TITLE, cells, present)


def _events(one: Mapping[str, Any]) -> Counter[str]:
    return Counter(option['event'] for option in one['options'])


def _comparisons(found: Sequence[Mapping[str, Any]]) -> list[Comparison]:
    alike = sum(_events(one) == paper.AUTOMATIC for one in found)
    centre = sum(any(o['name'] == CENTRE for o in one['options']) for one in found)
    others = Counter(o['name'] for one in found for o in one['options'] if not o['event'])
    seen = _seeds_by_name(found)
    fewest = min(seen[name] for name in PAPERS if name != CENTRE)
    cells_found = ', '.join(f'{name} ({count})' for name, count in others.most_common())
    kinds = (
        f'{alike} of {len(found)} extractions found four pickups, four dropoffs and one cell; '
        f'each pickup and dropoff is among the options of at least {fewest}.'
    )
    share = np.mean([one['visits'][MIDDLE] / max(one['visits']) for one in found])
    where = (
        f'The centre in {centre} of {len(found)} extractions. Cells: {cells_found or "none"}. The '
        f'centre has {share:.1%} of the visits of the cell that has most, on average.'
    )
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


def _seeds_by_name(found: Sequence[Mapping[str, Any]]) -> Counter[str]:
    """Return in how many extractions an option of each name was found."""
    return Counter(name for one in found for name in {o['name'] for o in one['options']})


def _said(number: int, found: str, agrees: bool) -> Comparison:
    statement = paper.FIGURE_3[number]
    return Comparison(statement.text, statement.where, found, agreement(agrees))


def _coverage(found: Sequence[Mapping[str, Any]]) -> tuple[str, bool]:
    """Compare in how many states one option can start, human ones as an expert means them."""
    domain = Taxi()
    meant = reference_options(domain)
    reached = search_space(domain).reached & ~domain.over()
    human = [float(meant[name].initiation[reached].mean()) for name in paper.TAUGHT['taxi']]
    automatic = [option['can_start'] for one in found for option in one['options']]
    text = (
        f'One automatic option can start in {np.mean(automatic):.0%} of states on average, one '
        f'human option, as an expert means it, in {np.mean(human):.0%}.'
    )
    return text, float(np.mean(human)) > float(np.mean(automatic))


def _picture(name: str, first: Mapping[str, Any]) -> Picture:
    domain = make_domain(name)
    targets = [option['cell'] for option in first['options']]
    seen = visit_map(domain, search_space(domain), np.array(first['visits']), targets)
    options = '; '.join(f'{n}: {o["name"]}' for n, o in enumerate(first['options'], start=1))
    label = f'Visits of greedy runs in {DOMAINS[name]}, with the targets of automatic options'
    caption = f'{DOMAINS[name]}. {options}'
    return Picture(f'fig3-{name}', label, seen.size, partial(_draw, seen), caption)


def _draw(seen: VisitMap, work: Drawing, paint: Paint) -> None:
    draw_visits(work, seen)


def _found_table(domain: str, by_seed: Mapping[int, Mapping[str, Any]]) -> Table:
    """Return in how many extractions each option was found, those of the paper in any case."""
    seen, papers = _seeds_by_name(list(by_seed.values())), PAPERS if domain == 'taxi' else ()
    others = sorted(set(seen) - set(papers), key=lambda name: (-seen[name], name))
    rows: list[list[Value]] = [
        [name, ('yes' if name in papers else 'no') if papers else None, seen[name], len(by_seed)]
        for name in (*papers, *others)
    ]
    columns = ['option', 'in the paper', 'found in', 'of extractions']
    title = f'{DOMAINS[domain]}: which options were found, and how often'
    return Table(f'fig3-found-{domain}', title, columns, rows, shown=bool(papers))


def _option_table(found: Found) -> Table:
    fields = ('name', 'visits', 'can_start', 'reaches')
    rows: list[list[Value]] = [
        [DOMAINS[domain], seed, number, *(option[name] for name in fields)]
        for domain, by_seed in found.items()
        for seed, one in by_seed.items()
        for number, option in enumerate(one['options'], start=1)
    ]
    columns = [
        'domain',
        'seed',
        'number',
        'option',
        'visits',
        'share of states where it can start',
    ]
    columns += ['share of these from which it came to its target']
    return Table('fig3-options', 'The options', columns, rows, shown=False)


def _seed_table(found: Found) -> Table:
    rows: list[list[Value]] = []
    for domain, by_seed in found.items():
        for seed, one in by_seed.items():
            events, reaches = _events(one), [option['reaches'] for option in one['options']]
            counts = [len(one['options']), *(events.get(event, 0) for event in paper.AUTOMATIC)]
            cost = [one['seconds'], one['game_steps'], one['episodes'], one['solved']]
            rows.append([DOMAINS[domain], seed, *counts, float(np.mean(reaches)), *cost])
    columns = [
        'domain',
        'seed',
        'options',
        'pickups',
        'dropoffs',
        'cells',
        'share that comes to the target',
    ]
    columns += ['seconds', 'game steps', 'episodes', 'share of runs that came to their goals']
    return Table('fig3-extractions', 'Each extraction, and what it cost', columns, rows)
