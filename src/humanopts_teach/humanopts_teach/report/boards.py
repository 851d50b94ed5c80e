"""Boards: walls and moves found in the exact transitions, and plans drawn on them."""

from collections.abc import Mapping
from dataclasses import dataclass
import string
from typing import Any

from humanopts_env.domains.base import BoardSlice, Transitions
from humanopts_learner.planning.exact import ExactPlan
from humanopts_teach.report.figures import Drawing, drawing, INK
from matplotlib.colors import Normalize
import numpy as np
from numpy.typing import NDArray

SIDES = ((0, 1), (1, 0))  # (row, column) steps to the neighbours looked at: east, south
MOST_MARKED = 24  # rows or columns up to which every cell shows what is chosen there
MOST_VECTOR_CELLS = 900  # boards of more cells are drawn as a bitmap
COLORS = 'cividis'
ARROW: dict[str, Any] = {'angles': 'xy', 'scale_units': 'xy', 'scale': 1, 'pivot': 'mid'}
LETTERS = string.ascii_uppercase + string.ascii_lowercase


@dataclass(frozen=True)
class Board:
    """One slice of a domain's states with what stands between its cells."""

    title: str
    states: NDArray[np.int32]  # (rows, cols); -1: no state there
    walls: tuple[NDArray[np.bool_], NDArray[np.bool_]]  # between a cell and its east, south
    moves: dict[int, tuple[int, int]]  # action -> (rows, cols) by which it moves the agent


def board_of(table: Transitions, layout: BoardSlice) -> Board:
    """
    Return states of some transitions with their walls and moves.

    Between two neighbouring states there is a wall where no action leads from one to the other. An
    action moves by what it moves in most of the cells that it leaves for another cell.
    """
    states = layout.states
    position = np.full((len(table.successor), 2), -1)
    position[states[states >= 0]] = np.argwhere(states >= 0)
    here = np.where(states >= 0, states, 0)
    possible = (table.probability[here] > 0) & (states >= 0)[:, :, None, None]
    arrives = np.where(possible, table.successor[here], -1)  # (rows, cols, A, B)
    walls = tuple(_walls(states, arrives, step) for step in SIDES)
    return Board(layout.title, states, (walls[0], walls[1]), _moves(states, arrives, position))


def _walls(
    states: NDArray[np.int32], arrives: NDArray[np.int32], step: tuple[int, int]
) -> NDArray[np.bool_]:
    """Return (rows, cols): a wall or an edge is on the east (0, 1) or south (1, 0) side."""
    rows, cols = states.shape
    first, second = (
        (slice(0, rows - step[0]), slice(0, cols - step[1])),
        np.s_[step[0] :, step[1] :],
    )
    a, b = states[first], states[second]
    leads = (arrives[first] == b[:, :, None, None]).any(axis=(2, 3))
    leads |= (arrives[second] == a[:, :, None, None]).any(axis=(2, 3))
    walls = states >= 0
    walls[first] = (a >= 0) != (b >= 0)
    walls[first] |= (a >= 0) & (b >= 0) & ~leads
    return walls


def _moves(
    states: NDArray[np.int32], arrives: NDArray[np.int32], position: NDArray[np.int64]
) -> dict[int, tuple[int, int]]:
    moves = {}
    rows, cols = np.nonzero(states >= 0)
    for action in range(arrives.shape[2]):
        reached = arrives[rows, cols, action, 0]
        inside = (reached >= 0) & (position[reached, 0] >= 0) & (reached != states[rows, cols])
        steps = position[reached[inside]] - np.stack([rows, cols], axis=1)[inside]
        if len(steps):
            kinds, counts = np.unique(steps, axis=0, return_counts=True)
            row, col = kinds[counts.argmax()]
            moves[action] = (int(row), int(col))
    return moves


def board_figures(plans: Mapping[str, ExactPlan], name: str) -> list[tuple[str, str]]:
    """
    Return SVG and caption for each board slice and plan, slice by slice; on one scale of values.

    :param plans: of one domain, by name.
    :param name: prefix of the identifiers.
    """
    if not plans:
        return []
    domain = next(iter(plans.values())).domain
    boards = [board_of(domain.transitions(), layout) for layout in domain.board_slices()]
    shown = [
        plan.solution.values[board.states[board.states >= 0]]
        for plan in plans.values()
        for board in boards
    ]
    if not shown:
        return []
    values = np.concatenate(shown)
    scale = Normalize(float(values.min()), float(values.max()))
    return [
        _figure(board, called, plan, scale, f'{name}-{b}-{p}')
        for b, board in enumerate(boards)
        for p, (called, plan) in enumerate(plans.items())
    ]


def _figure(
    board: Board, called: str, plan: ExactPlan, scale: Normalize, name: str
) -> tuple[str, str]:
    rows, cols = board.states.shape
    marked = max(rows, cols) <= MOST_MARKED
    label = f'Value and policy with the action set {called}, {board.title}'
    with drawing(name, label, 5.0, 1.1 + 3.3 * min(2.0, rows / cols)) as work:
        values = np.where(board.states >= 0, plan.solution.values[board.states], np.nan)
        draw_heat(work, board, values, scale, 'value (discounted reward units)')
        used = _draw_choices(work, board, plan, scale) if marked else []
        work.axes.set_title(f'Action set {called}\n{board.title}')
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
    """Draw the values (rows, cols) of the cells of a board, NaN where there is none, and walls."""
    rows, cols = values.shape
    axes, edges = work.axes, (np.arange(cols + 1) - 0.5, np.arange(rows + 1) - 0.5)
    bitmap = values.size > MOST_VECTOR_CELLS
    heat = axes.pcolormesh(*edges, values, cmap=COLORS, norm=scale, rasterized=bitmap)
    _draw_walls(work, board)
    axes.set(aspect='equal', xlabel='column', ylabel='row')
    axes.invert_yaxis()
    axes.spines[:].set_visible(False)
    bar = work.figure.colorbar(heat, ax=axes, shrink=0.85, pad=0.03)
    bar.set_label(unit)
    bar.outline.set_visible(False)


def _draw_walls(work: Drawing, board: Board) -> None:
    """Draw the walls and the edge of a board, cell (row, col) at (col, row)."""
    shown, (east, south) = board.states >= 0, board.walls
    style: dict[str, Any] = {'color': INK, 'lw': 2.2, 'capstyle': 'round', 'clip_on': False}
    row, col = np.nonzero(np.hstack([shown[:, :1], east])) - np.array([[0.5], [0.5]])
    work.axes.vlines(col, row, row + 1, **style)
    row, col = np.nonzero(np.vstack([shown[:1], south])) - np.array([[0.5], [0.5]])
    work.axes.hlines(row, col, col + 1, **style)


def _draw_choices(work: Drawing, board: Board, plan: ExactPlan, scale: Normalize) -> list[int]:
    """Mark every cell with its option's letter and the primitive action; return what is used."""
    size = min(8.0, 55.0 / max(board.states.shape))
    used, arrows = set(), list[tuple[Any, ...]]()
    for row, col in np.argwhere(board.states >= 0):
        state = board.states[row, col]
        chosen = int(plan.solution.best[state])
        if chosen < 0:
            continue
        used.add(chosen)
        action = chosen - len(plan.options)
        ink = '#ffffff' if scale(plan.solution.values[state]) < 0.55 else '#101418'
        style: dict[str, Any] = {'color': ink, 'size': size}
        if chosen < len(plan.options):
            action = int(plan.options[chosen].action[state])
            at = (col - 0.44, row - 0.44)
            work.axes.text(*at, _letter(chosen), ha='left', va='top', **style)
        if action in board.moves:
            arrow = 0.56 * np.array(board.moves[action][::-1]) / np.abs(board.moves[action]).max()
            arrows.append((col, row, *arrow, ink))
        else:
            name, at = plan.domain.actions[action].name, (col, row + 0.08)
            work.axes.text(*at, name, ha='center', va='center', weight='bold', **style)
    if arrows:
        *ends, inks = zip(*arrows)
        work.axes.quiver(*ends, color=inks, **ARROW)
    return sorted(used)
