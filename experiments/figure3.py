"""
Figure 3: options found without a person, in Taxi (section 7.3) and in the maze of Pac-Man.

The algorithm is that of Stolle and Precup (2002); see ``humanopts_learner.automatic``. One trial
is one extraction, with its own random tasks.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
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
from experiments.report import compare, Comparison, grouped, Picture, Section, Table
from experiments.trials import Rows, Trial

NAME = 'fig3'
TITLE = 'Figure 3: automatic options'
DOMAINS = {'taxi': 'Taxi', 'pacman': 'Pac-Man'}
COST = 7.0  # approximate processor seconds per trial
CENTRE = 'go to cell 2,2'  # centre of the 5 x 5 grid
LARGEST_SIDE = 5.0  # longer side of a drawn board, inches
PAPERS = (*(f'{event} at {name}' for event in ('pickup', 'dropoff') for name in 'RGYB'), CENTRE)
KINDS = {'pickups': 'pickup', 'dropoffs': 'dropoff', 'cells': ''}  # final event by kind
EACH = {'option': 'option', 'can start': 'share of states where it can start'}  # list columns


def trials(study: Study) -> list[Trial]:
    """Return one trial per domain and seed."""
    seeds = range(study.seed, study.seed + study.seeds)
    return [
        Trial(NAME, {'domain': domain, 'seed': seed}, extract, COST)
        for domain in DOMAINS
        for seed in seeds
    ]


def extract(parameters: Mapping[str, Any]) -> Rows:
    """Extract the options of a domain; return one row, see ``extraction_row``."""
    domain = make_domain(parameters['domain'])
    found = extraction(domain.name, parameters_json(domain), parameters['seed'])
    return [{**parameters, **extraction_row(found)}]


def extraction_row(found: AutomaticOptions) -> dict[str, Any]:
    """Return the row of an extraction; lists are in order of discovery, visits by cell."""
    reached, options = found.space.open, found.options
    events = [option.target.event for option in options]
    return {
        'options': len(options),
        **{kind: events.count(event) for kind, event in KINDS.items()},
        'share that reaches the target': float(np.mean([option.reaches for option in options])),
        'seconds': found.seconds,
        'game steps': found.game_steps,
        'episodes': found.episodes,
        'share of runs that reached their goals': found.solved,
        'option': [option.name for option in options],
        'can start': [float(option.initiation[reached].mean()) for option in options],
        'target': [int(option.target.cell) for option in options],
        'visits': found.visits.tolist(),
    }


def present(extractions: pd.DataFrame) -> Section:
    """Return the report section."""
    options = extractions.explode([*EACH])[['domain', 'seed', *EACH]].rename(columns=EACH)
    cost = extractions.drop(columns=[*EACH, 'target', 'visits', 'trial'], errors='ignore')
    by_domain = {domain: mine for (domain,), mine in grouped(extractions, ['domain'])}
    tables = [
        Table(
            f'fig3-found-{domain}',
            f'{DOMAINS[domain]}: how often each option was found',
            found_table(domain, mine['option']),
            shown=domain == 'taxi',
        )
        for domain, mine in by_domain.items()
    ]
    tables += [
        Table('fig3-options', 'The options', options, shown=False),
        Table('fig3-extractions', 'Each extraction, and its cost', cost),
    ]
    compared = _comparisons(by_domain['taxi']) if 'taxi' in by_domain else []
    pictures = [_picture(mine.iloc[0]) for mine in by_domain.values()]
    return Section(NAME, TITLE, compared, pictures, tables)


def found_table(domain: str, found: Iterable[Sequence[str]]) -> pd.DataFrame:
    """Count the extractions that found each option; every option of the paper has a row."""
    seen, papers = _seen(found), PAPERS if domain == 'taxi' else ()
    others = sorted(set(seen) - set(papers), key=lambda name: (-seen[name], name))
    rows = [
        [name, ('yes' if name in papers else 'no') if papers else None, seen[name]]
        for name in (*papers, *others)
    ]
    return pd.DataFrame(rows, columns=['option', 'in the paper', 'extractions'])


def _seen(found: Iterable[Sequence[str]]) -> Counter[str]:
    """Count the extractions that found each option, by name."""
    return Counter(name for names in found for name in set(names))


def _comparisons(taxi: pd.DataFrame) -> list[Comparison]:
    """Compare the extractions in Taxi with the paper's statements."""
    domain = Taxi()
    shares = {  # one flag per extraction
        'kinds': (taxi[[*KINDS]] == [*paper.AUTOMATIC]).all(axis=1),
        'centre': taxi['option'].map(lambda names: CENTRE in names),
        'more': taxi['options'] - len(domain.actions) == 3,
    }
    found = []
    for said, flags in shares.items():
        share = Interval.of_share(flags.to_numpy())
        count = {f'{sum(flags)} of {len(flags)} extractions,': share}
        found.append(compare(paper.SAID[said], share.above(0.5), 'found in', count, '.0%'))
    reached = search_space(domain).reached & ~domain.over()
    meant = [reference_options(domain)[name].initiation[reached] for name in paper.TAUGHT['taxi']]
    human = float(np.mean([starts.mean() for starts in meant]))
    automatic = Interval.of(taxi['can start'].map(np.mean))
    values: dict[str, Any] = {'automatic': automatic, 'human, as an expert means it': human}
    case = 'share of states where an option can start'
    general = compare(paper.SAID['general'], automatic.below(human), case, values, '.0%')
    return [*found, general]


def _picture(first: 'pd.Series[Any]') -> Picture:
    """Draw the visits of each cell, with the options numbered at their targets."""
    domain = make_domain(first['domain'])
    space, name = search_space(domain), DOMAINS[domain.name]
    assert space.board is not None, f'{name} has a board'
    states = space.board.states
    cells = np.where(states >= 0, space.cell[states], -1)  # cell of each board position; -1: none
    rows, cols = cells.shape
    draw = partial(_draw, first, cells, geometry(domain, space.board))
    side = LARGEST_SIDE / max(rows, cols)
    numbered = '; '.join(f'{n}: {option}' for n, option in enumerate(first['option'], start=1))
    size = side * cols + 1.2, side * rows + 0.8
    return Picture(f'fig3-{domain.name}', f'{name}. {numbered}', size, draw)


def _draw(first: 'pd.Series[Any]', cells: Any, board: Any, work: Drawing) -> None:
    visited = np.where(cells >= 0, np.asarray(first['visits'])[cells], np.nan)
    draw_heat(work, board, visited, Normalize(0.0, float(np.nanmax(visited))), 'visits')
    box = {'boxstyle': 'round,pad=0.25', 'fc': '#ffffff', 'ec': '#101418', 'lw': 1.0}
    style: dict[str, Any] = {'ha': 'center', 'va': 'center', 'weight': 'bold', 'bbox': box}
    size = min(max(7.5, 60.0 / max(cells.shape)), 11.0)
    for cell in set(first['target']):
        text = ', '.join(str(n) for n, of in enumerate(first['target'], start=1) if of == cell)
        for row, col in np.argwhere(cells == cell):
            work.axes.text(col, row, text, size=size, color='#101418', **style)
    work.axes.set_title('Visits of greedy runs, and automatic options')
    work.axes.tick_params(length=0)
