"""The map of automatic options: what is found is on it."""

from typing import Any

from humanopts_env.domains.base import BoardSlice, Domain, DomainError
from humanopts_env.domains.pacman.domain import PacMan
from humanopts_env.domains.rooms import Rooms
from humanopts_learner.automatic.config import Extraction
from humanopts_learner.automatic.extract import find_options, search_space
from humanopts_teach.report.automatic_figure import draw_visits, visit_map
from humanopts_teach.report.figures import Drawing
import numpy as np
import pytest

QUICK = Extraction(tasks=40, train_episodes=60, option_episodes=50)


@pytest.mark.parametrize('domain', [PacMan(maze='yard'), Rooms()])
def test_every_option_is_numbered_on_the_board(domain: Domain[Any]) -> None:
    found = find_options(domain, 0, QUICK)
    targets = [option.target.cell for option in found.options]
    seen = visit_map(domain, found.space, found.visits, targets)
    work = Drawing(*seen.size)
    draw_visits(work, seen)
    shown = ', '.join(text.get_text() for text in work.axes.texts).split(', ')
    assert sorted(map(int, shown)) == list(range(1, len(found.options) + 1))


def test_a_domain_without_a_board_is_refused() -> None:
    class Blind(Rooms):
        def board_slices(self) -> list[BoardSlice]:
            """Return none."""
            return []

    with pytest.raises(DomainError, match='no board'):
        visit_map(Blind(), search_space(Blind()), np.zeros(3, np.intp), [])
