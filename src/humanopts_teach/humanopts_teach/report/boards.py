"""Boards: walls and moves found in the exact transitions, and plans drawn on them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import string
from typing import Any

from humanopts_env.domains.base import BoardSlice, EnumerableDomain, Transitions
from humanopts_learner.planning.plan import Plan
from humanopts_teach.report.figures import CaptionedFigure, Drawing, drawing, INK
from matplotlib.colors import Normalize
import numpy as np
from numpy.typing import NDArray

SIDES = ((0, 1), (1, 0))  # (row, column) steps to the neighbours looked at: east, south
MOST_MARKED = 24  # rows or columns up to which every cell shows what is chosen there
MOST_VECTOR_CELLS = 900  # boards of more cells are drawn as a bitmap
COLORS = 'cividis'
LETTERS = string.ascii_uppercase + string.ascii_lowercase


@dataclass(frozen=True)
class Board:
    """One slice of a domain's states with what stands between its cells."""

    title: str
    states: NDArray[np.int32]  # (rows, cols); -1: no state there
    walls: tuple[NDArray[np.bool_], NDArray[np.bool_]]  # between a cell and its east, south
    moves: dict[int, tuple[int, int]]  # action -> (rows, cols) by which it moves the agent


def read_board(domain: EnumerableDomain[Any], layout: BoardSlice) -> Board:
    """Return a slice with its walls and moves, as ``board_of`` finds them."""
    return board_of(domain.transitions(), layout)


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


def board_figures(plans: Mapping[str, Plan], name: str) -> list[CaptionedFigure]:
    """
    Return one figure for each board slice and plan, slice by slice; all on one scale of values.

    :param plans: of one domain, by what each is called.
    :param name: prefix of the identifiers.
    """
    if not plans:
        return []
    domain = next(iter(plans.values())).domain
    boards = [read_board(domain, layout) for layout in domain.board_slices()]
    states = [board.states[board.states >= 0] for board in boards]
    if not states:
        return []
    values = np.concatenate(
        [plan.solution.values[shown] for plan in plans.values() for shown in states]
    )
    scale = Normalize(float(values.min()), float(values.max()))
    return [
        _figure(board, called, plan, scale, f'{name}-{b}-{p}')
        for b, board in enumerate(boards)
        for p, (called, plan) in enumerate(plans.items())
    ]


def _figure(board: Board, called: str, plan: Plan, scale: Normalize, name: str) -> CaptionedFigure:
    rows, cols = board.states.shape
    title = f'Action set {called}\n{board.title}'
    marked = max(rows, cols) <= MOST_MARKED
    label = f'Value and policy with the action set {called}, {board.title}'
    with drawing(name, label, 5.0, 1.1 + 3.3 * min(2.0, rows / cols)) as work:
        axes = work.axes
        values = np.where(board.states >= 0, plan.solution.values[board.states], np.nan)
        edges = np.arange(cols + 1) - 0.5, np.arange(rows + 1) - 0.5
        bitmap = values.size > MOST_VECTOR_CELLS
        heat = axes.pcolormesh(*edges, values, cmap=COLORS, norm=scale, rasterized=bitmap)
        draw_walls(work, board)
        used = _draw_choices(work, board, plan, scale) if marked else []
        axes.set(aspect='equal', xlabel='column', ylabel='row', title=title)
        axes.set_xticks(range(0, cols, -(-cols // 6)))
        axes.set_yticks(range(0, rows, -(-rows // 6)))
        axes.invert_yaxis()
        axes.spines[:].set_visible(False)
        bar = work.figure.colorbar(heat, ax=axes, shrink=0.85, pad=0.03)
        bar.set_label('value (discounted reward units)')
        bar.outline.set_visible(False)
    return CaptionedFigure(work.svg, _caption(plan, used) if marked else '')


def _caption(plan: Plan, used: Sequence[int]) -> str:
    legend = [f'{LETTERS[o]}: {plan.options[o].name}' for o in used if o < len(plan.options)]
    if any(column >= plan.first_fallback for column in used):
        legend.append('no letter: no option can start there, so one primitive action is taken')
    return '; '.join(legend)


def draw_walls(work: Drawing, board: Board) -> None:
    """Draw the walls and the edge of a board, cell (row, col) at (col, row)."""
    east, south = board.walls
    shown = board.states >= 0
    lines = [((c + 0.5, c + 0.5), (r - 0.5, r + 0.5)) for r, c in np.argwhere(east)]
    lines += [((c - 0.5, c + 0.5), (r + 0.5, r + 0.5)) for r, c in np.argwhere(south)]
    lines += [((-0.5, -0.5), (r - 0.5, r + 0.5)) for r in np.flatnonzero(shown[:, 0])]
    lines += [((c - 0.5, c + 0.5), (-0.5, -0.5)) for c in np.flatnonzero(shown[0])]
    for x, y in lines:
        work.axes.plot(x, y, color=INK, lw=2.2, solid_capstyle='round', clip_on=False)


def _draw_choices(work: Drawing, board: Board, plan: Plan, scale: Normalize) -> list[int]:
    """Mark every cell with its option's letter and the primitive action; return what is used."""
    cells = np.argwhere(board.states >= 0)
    states = board.states[tuple(cells.T)]
    columns = plan.solution.best[states]
    actions = _actions(plan, states)
    size = min(8.0, 55.0 / max(board.states.shape))
    for (row, col), state, column, action in zip(cells, states, columns, actions):
        if column < 0:
            continue
        ink = '#ffffff' if scale(plan.solution.values[state]) < 0.55 else '#101418'
        if column < len(plan.options):
            at = (col - 0.44, row - 0.44)
            style = {'color': ink, 'ha': 'left', 'va': 'top', 'size': size}
            work.axes.text(*at, LETTERS[column % len(LETTERS)], **style)
        if int(action) in board.moves:
            down, right = board.moves[int(action)]
            _draw_arrow(work, (row, col), (down, right), ink)
        else:
            name = plan.domain.actions[int(action)].name
            style = {'color': ink, 'ha': 'center', 'va': 'center', 'weight': 'bold'}
            work.axes.text(col, row + 0.08, name, size=size, **style)
    return sorted({int(column) for column in columns if column >= 0})


def _draw_arrow(work: Drawing, cell: tuple[int, int], move: tuple[int, int], ink: str) -> None:
    (row, col), (down, right) = cell, move
    size = 0.28 / max(abs(down), abs(right))
    work.axes.annotate(
        '',
        xy=(col + size * right, row + size * down),
        xytext=(col - size * right, row - size * down),
        arrowprops={'arrowstyle': '->', 'color': ink, 'lw': 1.5, 'shrinkA': 0, 'shrinkB': 0},
    )


def _actions(plan: Plan, states: NDArray[np.int32]) -> NDArray[np.int64]:
    """Return the primitive action that follows the plan's choice in each state."""
    columns = plan.solution.best[states].astype(np.int64)
    actions = columns - len(plan.options)
    for o, option in enumerate(plan.options):
        actions = np.where(columns == o, option.action[states], actions)
    return actions
