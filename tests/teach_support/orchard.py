"""The orchard of ``examples``, installed as a package, with options for a simulated teacher."""

from dataclasses import dataclass
from pathlib import Path
import sys

from humanopts_env.domains.replayed_domain import History
import pytest

ORCHARD = Path(__file__).parents[2] / 'examples' / 'humanopts_orchard'
if str(ORCHARD) not in sys.path:
    sys.path.append(str(ORCHARD))
from humanopts_orchard import BASKET, Field, Orchard  # noqa: E402 - not installed

__all__ = ['FILL', 'UNLOAD', 'Field', 'Orchard', 'install', 'reference_options']
POINTS = """
[humanopts.domains]
orchard = humanopts_orchard:Orchard
[humanopts.reference_options]
orchard = teach_support.orchard:reference_options
"""
HERE = 4  # value of a direction at the place itself, or without an apple


@dataclass(frozen=True)
class Walk:
    """Walk where a feature points, while it points anywhere and the basket allows it."""

    name: str
    features: tuple[str, ...]
    column: int
    baskets: range
    definition: str = 'Starts where it is useful; moves in the given direction; ends on arrival.'

    def can_start(self, state: History) -> bool:
        way = state.features[self.column]
        return not state.over and way != HERE and int(state.features[2]) in self.baskets

    def ends(self, state: History) -> bool:
        return not self.can_start(state)

    def optimal_actions(self, state: History) -> tuple[int, ...]:
        return (int(state.features[self.column]),) if self.can_start(state) else ()


FILL = Walk('fill the basket', ('apple_direction', 'basket'), 0, range(BASKET))
UNLOAD = Walk('carry it home', ('barn_direction', 'basket'), 1, range(1, BASKET + 1))


def reference_options(domain: Orchard) -> dict[str, Walk]:
    return {walk.name: walk for walk in (FILL, UNLOAD)}


def install(folder: Path, patch: pytest.MonkeyPatch) -> None:
    """Have the orchard found by its name."""
    info = folder / 'orchard-1.0.dist-info'
    info.mkdir()
    (info / 'METADATA').write_text('Metadata-Version: 2.1\nName: orchard\nVersion: 1.0\n')
    (info / 'entry_points.txt').write_text(POINTS)
    patch.syspath_prepend(str(folder))
