"""
Figure 3: options found without a person, in Taxi (section 7.3) and in the maze of Pac-Man.

By the algorithm of Stolle and Precup (2002), see ``humanopts_learner.automatic``. One trial is one
extraction, from random tasks of its own.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from humanopts_env.domains.registry import make_domain, parameters_json
from humanopts_env.domains.taxi import Taxi
from humanopts_env.domains.taxi_reference import reference_options
from humanopts_learner.automatic.extract import AutomaticOptions, search_space
from humanopts_learner.intervals import Interval
from humanopts_teach.report.boards import draw_heat, geometry
from humanopts_teach.report.figures import Drawing
from matplotlib.colors import Normalize
import numpy as np
import pandas as pd

from experiments import paper
from experiments.people import extraction, Study
from experiments.report import compared, Comparison, Done, listed, Picture, Section, Table, written
from experiments.trials import Trial

NAME = 'fig3'
TITLE = 'Figure 3: automatic options'
DOMAINS = {'taxi': 'Taxi', 'pacman': 'Pac-Man'}
COST = 7.0  # of a trial, about processor seconds
CENTRE = 'go to cell 2,2'  # of the 5 x 5 grid
MIDDLE = 12  # index of that cell
LARGEST_SIDE = 5.0  # of a picture's board, inches
PAPERS = (*(f'{event} at {name}' for event in ('pickup', 'dropoff') for name in 'RGYB'), CENTRE)


def trials(study: Study) -> list[Trial]:
    """Return one trial for each domain and seed."""
    seeds = range(study.seed, study.seed + study.seeds)
    return [
        Trial(NAME, {'domain': domain, 'seed': seed}, extract, COST)
        for domain in DOMAINS
        for seed in seeds
    ]


def extract(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Find the options of a domain; return them and the cost, see ``as_json``."""
    domain = make_domain(parameters['domain'])
    return as_json(extraction(domain.name, parameters_json(domain), parameters['seed']))


def as_json(found: AutomaticOptions) -> dict[str, Any]:
    """Return options in the order of finding, and what it cost to find them."""
    reached = found.space.open
    return {
        'options': [
            {
                'name': option.name,
                'cell': int(option.target.cell),
                'event': option.target.event,
                'visits': int(option.target.visits),
                'can_start': float(option.initiation[reached].mean()),
                'reaches': float(option.reaches),
            }
            for option in found.options
        ],
        'visits': found.visits.tolist(),
        'seconds': found.seconds,
        'game_steps': found.game_steps,
        'episodes': found.episodes,
        'solved': found.solved,
    }


def present(done: Done) -> Section:
    """Return the section of the report."""
    found: dict[str, list[Any]] = {}  # extractions by domain
    for parameters, one in done:
        found.setdefault(parameters['domain'], []).append(one)
    tables = [
        Table(
            f'fig3-found-{domain}',
            f'{DOMAINS[domain]}: which options were found, and how often',
            found_table(domain, extractions),
            shown=domain == 'taxi',
        )
        for domain, extractions in found.items()
    ]
    tables += [
        Table('fig3-options', 'The options', option_table(done), shown=False),
        Table('fig3-extractions', 'Each extraction, and what it cost', extraction_table(done)),
    ]
    pictures = [_picture(domain, first) for domain, (first, *_) in found.items()]
    compared_ones = _comparisons(found['taxi']) if 'taxi' in found else []
    return Section(NAME, TITLE, compared_ones, pictures, tables)


def found_table(domain: str, found: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """Return in how many extractions each option was found, those of the paper in any case."""
    seen, papers = _seen(found), PAPERS if domain == 'taxi' else ()
    others = sorted(set(seen) - set(papers), key=lambda name: (-seen[name], name))
    rows = [
        [name, ('yes' if name in papers else 'no') if papers else None, seen[name], len(found)]
        for name in (*papers, *others)
    ]
    return pd.DataFrame(rows, columns=['option', 'in the paper', 'found in', 'of extractions'])


def option_table(done: Done) -> pd.DataFrame:
    """Return a row for each option of each extraction."""
    named = {
        'name': 'option',
        'visits': 'visits',
        'can_start': 'share of states where it can start',
        'reaches': 'share of these from which it came to its target',
    }
    rows = [
        {'domain': DOMAINS[p['domain']], 'seed': p['seed'], 'number': number}
        | {title: option[name] for name, title in named.items()}
        for p, one in done
        for number, option in enumerate(one['options'], start=1)
    ]
    return pd.DataFrame(rows)


def extraction_table(done: Done) -> pd.DataFrame:
    """Return a row for each extraction."""
    rows = [
        {
            'domain': DOMAINS[parameters['domain']],
            'seed': parameters['seed'],
            'options': len(one['options']),
            'pickups': events['pickup'],
            'dropoffs': events['dropoff'],
            'cells': events[''],
            'share that comes to the target': float(
                np.mean([o['reaches'] for o in one['options']])
            ),
            'seconds': one['seconds'],
            'game steps': one['game_steps'],
            'episodes': one['episodes'],
            'share of runs that came to their goals': one['solved'],
        }
        for parameters, one in done
        for events in [_events(one)]
    ]
    return pd.DataFrame(rows)


def _events(one: Mapping[str, Any]) -> Counter[str]:
    """Return how many options end by each event; an empty name: by going to a cell."""
    return Counter(option['event'] for option in one['options'])


def _seen(found: Sequence[Mapping[str, Any]]) -> Counter[str]:
    """Return in how many extractions an option of each name was found."""
    return Counter(name for one in found for name in {o['name'] for o in one['options']})


def _comparisons(found: Sequence[Mapping[str, Any]]) -> list[Comparison]:
    """Compare extractions in Taxi with the paper's."""
    seen, taxi = _seen(found), Taxi()
    counts = [len(one['options']) for one in found]
    middle = np.mean([one['visits'][MIDDLE] / max(one['visits']) for one in found])
    automatic = Interval.of([np.mean([o['can_start'] for o in one['options']]) for one in found])
    reached = search_space(taxi).reached & ~taxi.over()
    meant = (reference_options(taxi)[name].initiation[reached] for name in paper.TAUGHT['taxi'])
    human = float(np.mean([float(starts.mean()) for starts in meant]))
    can_start: dict[str, Any] = {'automatic': automatic, 'human, as an expert means it': human}
    return [
        _mostly(
            'kinds',
            [_events(one) == paper.AUTOMATIC for one in found],
            {'the rarest pickup or dropoff in': min(seen[name] for name in PAPERS[:-1])},
        ),
        _mostly(
            'centre',
            [any(o['name'] == CENTRE for o in one['options']) for one in found],
            {'visits of the centre, of those of the most visited cell,': f'{middle:.1%}'},
        ),
        _mostly(
            'more',
            [count - len(taxi.actions) == 3 for count in counts],
            {'options': float(np.mean(counts)), 'primitive actions': len(taxi.actions)},
        ),
        compared(
            paper.SAID['general'],
            listed('share of states where an option can start', can_start, '.0%'),
            automatic.below(human),
        ),
    ]


def _mostly(said: str, flags: Sequence[bool], more: Mapping[str, Any]) -> Comparison:
    """Compare in how many extractions something was found with more than half of all."""
    share = Interval.of_share(np.array(flags))
    found: dict[str, Any] = {
        f'{sum(flags)} of {len(flags)} extractions,': written(share, '.0%'),
        **more,
    }
    return compared(paper.SAID[said], listed('found in', found), share.above(0.5))


def _picture(name: str, first: Mapping[str, Any]) -> Picture:
    """Return the visits of each cell, with the options numbered at their targets."""
    domain, options = make_domain(name), list(enumerate(first['options'], start=1))
    space = search_space(domain)
    assert space.board is not None, f'{name} has a board'
    board, states = geometry(domain, space.board), space.board.states
    cells = np.where(states >= 0, space.cell[states], -1)  # of each place; -1: none
    rows, cols = cells.shape
    labels: dict[int, list[str]] = {}  # numbers by cell
    for number, option in options:
        labels.setdefault(option['cell'], []).append(str(number))

    def draw(work: Drawing) -> None:
        visited = np.where(cells >= 0, np.asarray(first['visits'])[cells], np.nan)
        draw_heat(work, board, visited, Normalize(0.0, float(np.nanmax(visited))), 'visits')
        box = {'boxstyle': 'round,pad=0.25', 'fc': '#ffffff', 'ec': '#101418', 'lw': 1.0}
        style: dict[str, Any] = {'ha': 'center', 'va': 'center', 'weight': 'bold', 'bbox': box}
        size = min(max(7.5, 60.0 / max(rows, cols)), 11.0)
        for cell, numbers in labels.items():
            for row, col in np.argwhere(cells == cell):
                text = ', '.join(numbers)
                work.axes.text(col, row, text, size=size, color='#101418', **style)
        work.axes.set_title('Visits of greedy runs, and automatic options')
        work.axes.tick_params(length=0)

    side = LARGEST_SIDE / max(rows, cols)
    size = side * cols + 1.2, side * rows + 0.8
    label = f'Visits of greedy runs in {DOMAINS[name]}, with the targets of automatic options'
    caption = f'{DOMAINS[name]}. ' + '; '.join(f'{n}: {option["name"]}' for n, option in options)
    return Picture(f'fig3-{name}', label, size, draw, caption)
