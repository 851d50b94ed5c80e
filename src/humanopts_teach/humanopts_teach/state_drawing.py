"""A state of a game as a drawing: lines of characters with colours, for screens and pages."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

from humanopts_env.domains.base import Domain
from rich.cells import cell_len


@dataclass(frozen=True, slots=True)
class StateDrawing:
    """A drawn state; without lines, nothing is drawn yet."""

    board: tuple[str, ...] = ()  # lines, each as wide as the others
    notes: tuple[str, ...] = ()  # lines below it, which may be wider
    styles: Mapping[str, str] = field(default_factory=dict)  # of characters, in rich's notation


def draw_state(
    domain: Domain[Any], state: Any, shown: Collection[str] | None = None
) -> StateDrawing:
    """
    Return a state as its domain draws it.

    :param shown: names of the features that may be revealed; None: all.
    """
    lines = domain.render(state, shown).split('\n')
    width = cell_len(lines[0])
    end = next((n for n, line in enumerate(lines) if cell_len(line) != width), len(lines))
    return StateDrawing(tuple(lines[:end]), tuple(lines[end:]), domain.glyph_styles)
