"""Where automatic options were found: visits of greedy runs, and the bottlenecks among them."""

from typing import Any

from humanopts_env.domains.base import BoardSlice, Domain, is_enumerable
from humanopts_env.domains.pacman.domain import PacMan
from humanopts_learner.automatic.extract import AutomaticOptions
from humanopts_teach.report.board import Board, board_of
from humanopts_teach.report.board_figure import COLORS, draw_walls
from humanopts_teach.report.figures import CaptionedFigure, Drawing, drawing
from matplotlib.colors import Normalize
import numpy as np

LARGEST_SIDE = 5.0  # inches


def automatic_figure(
    domain: Domain[Any], found: AutomaticOptions, name: str
) -> CaptionedFigure | None:
    """
    Draw the visits of each cell, and number the options at their targets (paper, figure 3).

    :param found: in this domain.
    :param name: prefix of the identifiers.
    :return: None where the domain has no board.
    """
    board = _board(domain, found)
    if board is None:
        return None
    rows, cols = board.states.shape
    cells = np.where(board.states >= 0, found.ground.cell[board.states], -1)
    visits = np.where(cells >= 0, found.visits[cells], np.nan)
    side = LARGEST_SIDE / max(rows, cols)
    label = f'Visits of greedy runs in {domain.name}, with the targets of automatic options'
    with drawing(name, label, side * cols + 1.2, side * rows + 0.8) as work:
        edges = np.arange(cols + 1) - 0.5, np.arange(rows + 1) - 0.5
        scale = Normalize(0.0, float(np.nanmax(visits)))
        heat = work.axes.pcolormesh(*edges, visits, cmap=COLORS, norm=scale)
        draw_walls(work, board)
        for cell, text in _labels(found).items():
            for row, col in np.argwhere(cells == cell):
                _mark(work, (row, col), text, max(7.5, 60.0 / max(rows, cols)))
        work.axes.set(aspect='equal', xlabel='column', ylabel='row')
        work.axes.set_title('Visits of greedy runs, and automatic options')
        work.axes.invert_yaxis()
        work.axes.tick_params(length=0)
        work.axes.spines[:].set_visible(False)
        bar = work.figure.colorbar(heat, ax=work.axes, shrink=0.85, pad=0.03)
        bar.set_label('visits')
        bar.outline.set_visible(False)
    options = enumerate(found.options, start=1)
    return CaptionedFigure(work.svg, '; '.join(f'{n}: {option.name}' for n, option in options))


def _board(domain: Domain[Any], found: AutomaticOptions) -> Board | None:
    """Return the board that visits are drawn on."""
    if isinstance(domain, PacMan):
        maze = domain.rules.maze
        cells = np.full((maze.rows, maze.cols), -1, dtype=np.int32)
        cells[tuple(np.transpose(maze.cells))] = range(len(maze.cells))
        return board_of(found.ground.rules, BoardSlice('the maze', cells))
    slices = domain.board_slices() if is_enumerable(domain) else []
    return board_of(found.ground.rules, slices[0]) if slices else None


def _labels(found: AutomaticOptions) -> dict[int, str]:
    """Return the numbers of the options by the cell of their target."""
    labels: dict[int, str] = {}
    for number, option in enumerate(found.options, start=1):
        before = labels.get(option.target.cell)
        labels[option.target.cell] = f'{before}, {number}' if before else str(number)
    return labels


def _mark(work: Drawing, cell: tuple[int, int], text: str, size: float) -> None:
    row, col = cell
    box = {'boxstyle': 'round,pad=0.25', 'fc': '#ffffff', 'ec': '#101418', 'lw': 1.0}
    style: dict[str, Any] = {'ha': 'center', 'va': 'center', 'color': '#101418', 'weight': 'bold'}
    work.axes.text(col, row, text, size=min(size, 11.0), bbox=box, **style)
