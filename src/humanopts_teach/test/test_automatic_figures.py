"""Figures of automatic options and of learning: what is found is in them."""

import re
from typing import Any

from humanopts_env.domains.base import BoardSlice, Domain
from humanopts_env.domains.pacman.domain import PacMan
from humanopts_env.domains.rooms import Rooms
from humanopts_learner.automatic.extract import find_options
from humanopts_learner.automatic.how import Extraction
from humanopts_learner.qlearning.curves import band
from humanopts_teach.report.automatic_figure import automatic_figure
from humanopts_teach.report.steps_figure import steps_figure
import numpy as np
import pytest

QUICK = Extraction(tasks=40, train_episodes=60, option_episodes=50)


def texts(svg: str) -> list[str]:
    """Return the texts of a figure."""
    return re.findall(r'<text[^>]*>([^<]+)</text>', svg)


@pytest.mark.parametrize('domain', [PacMan(maze='yard'), Rooms()])
def test_every_option_is_numbered_on_the_board_and_named_below(domain: Domain[Any]) -> None:
    found = find_options(domain, 0, QUICK)
    figure = automatic_figure(domain, found, 'automatic')
    assert figure is not None
    shown = texts(figure.svg)
    for number, option in enumerate(found.options, start=1):
        assert str(number) in shown
        assert f'{number}: {option.name}' in figure.caption


def test_a_domain_without_a_board_has_no_figure_of_visits() -> None:
    class Blind(Rooms):
        def board_slices(self) -> list[BoardSlice]:
            """Return none."""
            return []

    assert automatic_figure(Blind(), find_options(Blind(), 0, QUICK), 'automatic') is None


def test_every_action_set_is_named_in_the_figure_of_steps() -> None:
    curve = band(np.arange(24.0).reshape(4, 6))
    figure = steps_figure({'human': curve, 'primitive': curve}, 'steps', 'Taxi')
    assert {'human', 'primitive', 'Taxi', 'steps per episode'} <= set(texts(figure.svg))
