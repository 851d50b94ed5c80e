"""Drawings of the values and policies of plans on boards."""

from collections.abc import Mapping
import string
from typing import Any

from humanopts_env.board import Board
from humanopts_env.domains.base import BoardSlice, Domain
from humanopts_env.domains.capabilities import board_of
from humanopts_env.seeding import generator
from humanopts_learner.planning.exact_plan import ExactPlan
from humanopts_teach.report.figures import Drawing, drawing, GRID, INK
from matplotlib.colors import Normalize
from matplotlib.patches import Rectangle
import numpy as np
from numpy.typing import NDArray

ARROWS = {'up': '↑', 'down': '↓', 'left': '←', 'right': '→'}  # symbols by key
MAX_MARKED = 24  # maximum number of rows or columns for which cells show their choices
MAX_VECTOR_CELLS = 900  # larger boards are drawn as bitmaps
COLORS = 'cividis'
LETTERS = string.ascii_uppercase + string.ascii_lowercase


def board_figures(plans: Mapping[str, ExactPlan], name: str) -> list[tuple[str, str]]:
    """
    Return SVG and caption for each board slice and plan, ordered by slice, on one value scale.

    :param plans: plans of one domain, by name.
    :param name: prefix of the identifiers.
    """
    if not plans:
        return []
    domain = next(iter(plans.values())).domain
    layouts = domain.board_slices()
    shown = [
        plan.solution.values[layout.states[layout.states >= 0]]
        for plan in plans.values()
        for layout in layouts
    ]
    if not shown:
        return []
    values = np.concatenate(shown)
    scale = Normalize(float(values.min()), float(values.max()))
    return [
        _figure(layout, called, plan, scale, f'{name}-{b}-{p}')
        for b, layout in enumerate(layouts)
        for p, (called, plan) in enumerate(plans.items())
    ]


def geometry(domain: Domain, layout: BoardSlice) -> Board:
    """Return the blocks and walls of the board of a layout."""
    rows, cols = layout.states.shape
    board = board_of(domain, domain.reset(generator(0, 'board')), ())
    return board if board.rows else Board(rows, cols)


def _figure(
    layout: BoardSlice, called: str, plan: ExactPlan, scale: Normalize, name: str
) -> tuple[str, str]:
    rows, cols = layout.states.shape
    marked = max(rows, cols) <= MAX_MARKED
    label = f'Value and policy with the action set {called}, {layout.title}'
    with drawing(name, label, 5.0, 1.1 + 3.3 * min(2.0, rows / cols)) as work:
        values = np.where(layout.states >= 0, plan.solution.values[layout.states], np.nan)
        board = geometry(plan.domain, layout)
        draw_heat(work, board, values, scale, 'value (discounted reward units)')
        used = _draw_choices(work, layout, plan, scale) if marked else []
        work.axes.set_title(f'Action set {called}\n{layout.title}')
        work.axes.set_xticks(range(0, cols, -(-cols // 6)))
        work.axes.set_yticks(range(0, rows, -(-rows // 6)))
    n_options = len(plan.options)
    legend = [f'{_letter(o)}: {plan.options[o].name}' for o in used if o < n_options]
    if any(option >= plan.first_fallback for option in used):
        legend.append('no letter: no option can start there, so one primitive action is taken')
    return work.svg, '; '.join(legend)


def _letter(option: int) -> str:
    return LETTERS[option % len(LETTERS)]


def draw_heat(
    work: Drawing, board: Board, values: NDArray[np.float64], scale: Normalize, unit: str
) -> None:
    """Draw the walls of a board and the values of its cells, (rows, cols); NaN: no value."""
    rows, cols = values.shape
    axes, edges = work.axes, (np.arange(cols + 1) - 0.5, np.arange(rows + 1) - 0.5)
    bitmap = values.size > MAX_VECTOR_CELLS
    heat = axes.pcolormesh(*edges, values, cmap=COLORS, norm=scale, rasterized=bitmap)
    _draw_walls(work, board)
    axes.set(aspect='equal', xlabel='column', ylabel='row')
    axes.invert_yaxis()
    axes.spines[:].set_visible(False)
    bar = work.figure.colorbar(heat, ax=axes, shrink=0.85, pad=0.03)
    bar.set_label(unit)
    bar.outline.set_visible(False)


def _draw_walls(work: Drawing, board: Board) -> None:
    """Draw the frame, blocks and walls of a board; cell (row, col) is drawn at (col, row)."""
    for row, col in board.blocks:
        work.axes.add_patch(Rectangle((col - 0.5, row - 0.5), 1, 1, color=GRID, lw=0))
    style: dict[str, Any] = {'color': INK, 'lw': 2.2, 'clip_on': False}
    for top, left, bottom, right in board.edges():
        ends = (left - 0.5, right - 0.5), (top - 0.5, bottom - 0.5)
        work.axes.plot(*ends, solid_capstyle='round', **style)


def _draw_choices(
    work: Drawing, layout: BoardSlice, plan: ExactPlan, scale: Normalize
) -> list[int]:
    """Mark every cell with the letter of its option and its action; return the options."""
    size, used = min(8.0, 55.0 / max(layout.states.shape)), set()
    for row, col in np.argwhere(layout.states >= 0):
        state = layout.states[row, col]
        chosen = int(plan.solution.best[state])
        if chosen < 0:
            continue
        used.add(chosen)
        dark = scale(plan.solution.values[state]) < 0.55
        style: dict[str, Any] = {'color': '#ffffff' if dark else '#101418', 'va': 'center'}
        action = chosen - len(plan.options)
        if chosen < len(plan.options):
            action = int(plan.options[chosen].action[state])
            at = col - 0.44, row - 0.3
            work.axes.text(*at, _letter(chosen), size=size, ha='left', **style)
        primitive = plan.domain.actions[action]
        arrow = ARROWS.get(primitive.key)
        large = {'size': 2 * size} if arrow else {'size': size, 'weight': 'bold'}
        work.axes.text(col, row + 0.08, arrow or primitive.name, ha='center', **large, **style)
    return sorted(used)
