"""Where automatic options were found: visits of greedy runs, and the bottlenecks among them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from humanopts_env.domains.base import Domain, DomainError
from humanopts_env.domains.search_space import SearchSpace
from humanopts_teach.report.boards import Board, board_of, draw_heat
from humanopts_teach.report.figures import Drawing
from matplotlib.colors import Normalize
import numpy as np
from numpy.typing import NDArray

LARGEST_SIDE = 5.0  # inches


@dataclass(frozen=True)
class VisitMap:
    """What is drawn of automatic options: visits and targets by cell."""

    board: Board
    cell: NDArray[np.intp]  # (S,) of each state, 0..K-1
    visits: NDArray[np.intp]  # (K,)
    targets: Sequence[int]  # cell of each option

    @property
    def size(self) -> tuple[float, float]:
        """Inches."""
        rows, cols = self.board.states.shape
        side = LARGEST_SIDE / max(rows, cols)
        return side * cols + 1.2, side * rows + 0.8


def visit_map(
    domain: Domain[Any], space: SearchSpace, visits: NDArray[np.intp], targets: Sequence[int]
) -> VisitMap:
    """
    Return what to draw of a search for options.

    :param visits: (K,) by cell.
    :param targets: cell of each option.
    :raises DomainError: the domain has no board.
    """
    if space.board is None:
        raise DomainError(f'{domain.name} has no board to draw visits on')
    return VisitMap(board_of(space.transitions, space.board), space.cell, visits, targets)


def draw_visits(work: Drawing, seen: VisitMap) -> None:
    """Draw the visits of each cell, and number the options at their targets (paper, figure 3)."""
    rows, cols = seen.board.states.shape
    cells = np.where(seen.board.states >= 0, seen.cell[seen.board.states], -1)
    visits = np.where(cells >= 0, seen.visits[cells], np.nan)
    draw_heat(work, seen.board, visits, Normalize(0.0, float(np.nanmax(visits))), 'visits')
    box = {'boxstyle': 'round,pad=0.25', 'fc': '#ffffff', 'ec': '#101418', 'lw': 1.0}
    size = min(max(7.5, 60.0 / max(rows, cols)), 11.0)
    style: dict[str, Any] = {'ha': 'center', 'va': 'center', 'color': '#101418', 'weight': 'bold'}
    labels: dict[int, list[str]] = {}
    for number, target in enumerate(seen.targets, start=1):
        labels.setdefault(target, []).append(str(number))
    for target, numbers in labels.items():
        for row, col in np.argwhere(cells == target):
            work.axes.text(col, row, ', '.join(numbers), size=size, bbox=box, **style)
    work.axes.set_title('Visits of greedy runs, and automatic options')
    work.axes.tick_params(length=0)
