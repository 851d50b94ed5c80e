"""Options written by hand, beside learned ones: the example on its page, and what is refused."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
import re
from typing import Any

from humanopts_env.arrays import Rows
from humanopts_env.domains.base import Domain
from humanopts_env.domains.pacman.domain import PacMan
from humanopts_env.domains.taxi import Taxi
from humanopts_learner import plan
from humanopts_learner.options.learned_option import OptionError
import numpy as np
import pytest

PAGE = Path(__file__).parents[3] / 'docs/how-to/use-options-as-actions.md'
TAXI, YARD = Taxi(), PacMan('yard', max_steps=60)


@dataclass
class Own:
    """An option that goes one step from everywhere, apart from what a test changes."""

    can_start: Callable[[Rows], Any] = lambda rows: np.ones(len(rows), dtype=bool)
    action: Callable[[Rows], Any] = lambda rows: np.zeros(len(rows), dtype=int)
    ends: Callable[[Rows], Any] = lambda rows: np.ones(len(rows), dtype=bool)
    name: str = 'own'
    max_steps: int = 5


def test_the_option_on_the_page_is_planned_with(capsys: pytest.CaptureFixture[str]) -> None:
    example = re.findall(r'```python\n(.*?)```', PAGE.read_text(), re.DOTALL)[-1]
    exec(compile(example, PAGE, 'exec'), {'__name__': 'example'})
    assert float(capsys.readouterr().out) > -12


@pytest.mark.parametrize('domain', [TAXI, YARD])
@pytest.mark.parametrize(
    ('own', 'text'),
    [
        (Own(action=lambda rows: np.full(len(rows), 6)), 'takes action 6; they are 0 to'),
        (Own(action=lambda rows: np.full(len(rows), -1)), 'takes action -1; they are 0 to'),
        (Own(action=lambda rows: np.zeros(len(rows))), 'action of .* array of .* integers'),
        (Own(ends=lambda rows: True), 'ends of .* array of .* bools'),
        (Own(ends=lambda rows: np.ones((len(rows), 1), dtype=bool)), 'ends of .* one for each'),
        (Own(can_start=lambda rows: rows[:, 0]), 'can_start of .* array of .* bools'),
        (Own(can_start=lambda rows: None), 'can_start of .* array of .* bools'),
    ],
)
def test_wrong_answers_are_refused_by_name(domain: Domain, own: Own, text: str) -> None:
    with pytest.raises(OptionError, match=text) as error:
        plan(domain, [own], game_steps=2000 if domain is YARD else 0)
    assert "'own'" in str(error.value)


@pytest.mark.parametrize('domain', [TAXI, YARD])
def test_a_right_one_is_planned_with(domain: Domain) -> None:
    """Its answers may be lists."""
    for own in (Own(), Own(action=lambda rows: [0] * len(rows))):
        assert plan(domain, [own], game_steps=2000 if domain is YARD else 0)
