"""
Figure 3: options found without a person, in Taxi (section 7.3) and in the maze of Pac-Man.

By the algorithm of Stolle and Precup (2002), see ``humanopts_learner.automatic``. One trial is one
extraction, from random tasks of its own.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from humanopts_env.arrays import Ints
from humanopts_env.domains.registry import make_domain, parameters_json
from humanopts_env.domains.taxi import Taxi
from humanopts_env.domains.taxi_reference import reference_options
from humanopts_learner.automatic.extract import AutomaticOptions, search_space
from humanopts_learner.intervals import Interval
from humanopts_teach.report.boards import Board, board_of, draw_heat
from humanopts_teach.report.figures import Drawing
from matplotlib.colors import Normalize
import numpy as np
import pandas as pd

from experiments import paper
from experiments.people import extraction, Study
from experiments.report import compared, Comparison, Done, Picture, Section, Table, written
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
    return Section(
        NAME,
        TITLE,
        _comparisons(found['taxi']) if 'taxi' in found else [],
        [_picture(domain, first) for domain, (first, *_) in found.items()],
        [
            *(
                Table(
                    f'fig3-found-{domain}',
                    f'{DOMAINS[domain]}: which options were found, and how often',
                    found_table(domain, extractions),
                    shown=domain == 'taxi',
                )
                for domain, extractions in found.items()
            ),
            Table('fig3-options', 'The options', option_table(done), shown=False),
            Table('fig3-extractions', 'Each extraction, and what it cost', extraction_table(done)),
        ],
    )


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
    rows = [
        {
            'domain': DOMAINS[parameters['domain']],
            'seed': parameters['seed'],
            'number': number,
            'option': option['name'],
            'visits': option['visits'],
            'share of states where it can start': option['can_start'],
            'share of these from which it came to its target': option['reaches'],
        }
        for parameters, one in done
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
            'pickups': _events(one)['pickup'],
            'dropoffs': _events(one)['dropoff'],
            'cells': _events(one)[''],
            'share that comes to the target': float(
                np.mean([option['reaches'] for option in one['options']])
            ),
            'seconds': one['seconds'],
            'game steps': one['game_steps'],
            'episodes': one['episodes'],
            'share of runs that came to their goals': one['solved'],
        }
        for parameters, one in done
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
    seen = _seen(found)
    alike = [_events(one) == paper.AUTOMATIC for one in found]
    central = [any(o['name'] == CENTRE for o in one['options']) for one in found]
    fewest = min(seen[name] for name in PAPERS if name != CENTRE)
    cells = Counter(o['name'] for one in found for o in one['options'] if not o['event'])
    listed = ', '.join(f'{name} ({count})' for name, count in cells.most_common())
    share = np.mean([one['visits'][MIDDLE] / max(one['visits']) for one in found])
    counts, actions = [len(one['options']) for one in found], len(Taxi().actions)
    more = [count - actions == 3 for count in counts]
    automatic = Interval.of([np.mean([o['can_start'] for o in one['options']]) for one in found])
    human = _human_initiation()
    return [
        compared(
            paper.FIGURE_3['kinds'],
            f'{_share(alike)}; the rarest pickup or dropoff in {fewest}',
            _mostly(alike),
        ),
        compared(
            paper.FIGURE_3['centre'],
            f'{_share(central)}; cells: {listed or "none"}; visits of the centre: {share:.1%} '
            'of those of the most visited cell',
            _mostly(central),
        ),
        compared(
            paper.FIGURE_3['more'],
            f'{np.mean(counts):.1f} options, {actions} primitive actions; three more in '
            f'{_share(more)}',
            _mostly(more),
        ),
        compared(
            paper.FIGURE_3['general'],
            f'share of states where an option can start: automatic {written(automatic, ".0%")}, '
            f'human, as an expert means it, {human:.0%}',
            automatic.below(human),
        ),
    ]


def _share(found: Sequence[bool]) -> str:
    """Return in how many extractions something was found, and the interval of the share."""
    share = Interval.of_share(np.array(found))
    return f'{sum(found)} of {len(found)} extractions ({share.low:.0%} to {share.high:.0%})'


def _mostly(found: Sequence[bool]) -> bool | None:
    """Return whether more than half of all extractions would find it; None: not decided."""
    return Interval.of_share(np.array(found)).above(0.5)


def _human_initiation() -> float:
    """Return the mean share of Taxi's states in which the paper's human options can start."""
    domain = Taxi()
    meant = reference_options(domain)
    reached = search_space(domain).reached & ~domain.over()
    shares = [float(meant[name].initiation[reached].mean()) for name in paper.TAUGHT['taxi']]
    return float(np.mean(shares))


def _picture(name: str, first: Mapping[str, Any]) -> Picture:
    domain = make_domain(name)
    space, targets = search_space(domain), [option['cell'] for option in first['options']]
    assert space.board is not None, f'{name} has a board'
    board = board_of(space.transitions, space.board)
    cells = np.where(board.states >= 0, space.cell[board.states], -1)
    rows, cols = cells.shape
    side = LARGEST_SIDE / max(rows, cols)
    options = '; '.join(f'{n}: {o["name"]}' for n, o in enumerate(first['options'], start=1))
    label = f'Visits of greedy runs in {DOMAINS[name]}, with the targets of automatic options'
    caption = f'{DOMAINS[name]}. {options}'
    draw = partial(_draw_visits, board, cells, first['visits'], targets)
    size = side * cols + 1.2, side * rows + 0.8
    return Picture(f'fig3-{name}', label, size, draw, caption)


def _draw_visits(
    board: Board, cells: Ints, visits: Sequence[int], targets: Sequence[int], work: Drawing
) -> None:
    """
    Draw the visits of each cell, and number the options at their targets.

    :param cells: (rows, cols) the cell in each place of the board; -1: none.
    :param visits: (K,) by cell.
    :param targets: cell of each option.
    """
    rows, cols = cells.shape
    visited = np.where(cells >= 0, np.asarray(visits)[cells], np.nan)
    draw_heat(work, board, visited, Normalize(0.0, float(np.nanmax(visited))), 'visits')
    box = {'boxstyle': 'round,pad=0.25', 'fc': '#ffffff', 'ec': '#101418', 'lw': 1.0}
    size = min(max(7.5, 60.0 / max(rows, cols)), 11.0)
    style: dict[str, Any] = {'ha': 'center', 'va': 'center', 'color': '#101418', 'weight': 'bold'}
    labels: dict[int, list[str]] = {}
    for number, target in enumerate(targets, start=1):
        labels.setdefault(target, []).append(str(number))
    for target, numbers in labels.items():
        for row, col in np.argwhere(cells == target):
            work.axes.text(col, row, ', '.join(numbers), size=size, bbox=box, **style)
    work.axes.set_title('Visits of greedy runs, and automatic options')
    work.axes.tick_params(length=0)
