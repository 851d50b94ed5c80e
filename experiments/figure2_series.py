"""What the cells of Figure 2 come to: curves by option and strategy, and demonstrations needed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments.bands import Band, band
from experiments.cells import Cell

MEASURES = ('policy', 'initiation', 'termination')  # of accuracy
LEVELS = (0.95, 1.0)  # of policy accuracy, whose cost in demonstrations is told
PEOPLE = 'people'  # the group of those in bags


@dataclass(frozen=True, order=True)
class Case:
    """What one curve is of."""

    domain: str
    option: str
    group: str  # of participants
    strategy: str  # of start states


@dataclass(frozen=True)
class Needed:
    """What it took people to come to a level of policy accuracy."""

    level: float
    demonstrations: tuple[int | None, ...]  # of each person, at the first time; None: never
    asked: tuple[int | None, ...]  # start states until then, "not here" answers included
    longest: int  # demonstrations that anybody gave

    @property
    def reached(self) -> int:
        """How many people came to it."""
        return sum(number is not None for number in self.demonstrations)

    @property
    def complete(self) -> bool:
        """Whether everybody did."""
        return self.reached == len(self.demonstrations)

    @property
    def mean(self) -> float:
        """Of the demonstrations; where not ``complete``, the mean is at least so much."""
        return float(np.mean([n or self.longest for n in self.demonstrations]))

    @property
    def text(self) -> str:
        """The mean in words."""
        count = len(self.demonstrations)
        if self.complete:
            return f'{self.mean:.1f}'
        if not self.reached:
            return f'not within {self.longest}'
        return f'over {self.mean:.1f} ({self.reached} of {count} people)'


@dataclass(frozen=True)
class Series:
    """The curves of some people; column n - 1 is after n demonstrations."""

    case: Case
    codes: tuple[str, ...]  # (P,) of the people
    accuracy: NDArray[np.float64]  # (3, P, N) by ``MEASURES``; NaN where there is none
    not_here: NDArray[np.float64]  # (P, N) "not here" answers so far
    minutes: tuple[float, ...]  # (P,) of the whole lesson
    cut_short: tuple[str, ...]  # (P,) why, in words; empty: it was not

    def bands(self) -> dict[str, Band]:
        """Return mean and band over people, by measure."""
        return {name: band(values, 0.0, 1.0) for name, values in zip(MEASURES, self.accuracy)}

    def needed(self, level: float) -> Needed:
        """Return what it took each person to come to a policy accuracy."""
        reached = self.accuracy[0] >= level - 1e-12
        first = [int(row.argmax()) if row.any() else None for row in reached]
        asked = [
            None if n is None else n + 1 + int(said[n]) for n, said in zip(first, self.not_here)
        ]
        demonstrations = tuple(None if n is None else n + 1 for n in first)
        return Needed(level, demonstrations, tuple(asked), self.accuracy.shape[2])


def gather(cells: Sequence[Cell], results: Mapping[str, Any]) -> list[Series]:
    """Return the curves of all cells that have a result, and something that can be measured."""
    people: dict[Case, list[tuple[str, Any]]] = {}
    for cell in cells:
        result = results.get(cell.key)
        if result is not None and any(point[2] is not None for point in result['points']):
            case, code = _case(cell.parameters)
            people.setdefault(case, []).append((code, result))
    return [_series(case, members) for case, members in people.items()]


def _case(parameters: Mapping[str, Any]) -> tuple[Case, str]:
    """Return what a cell belongs to, and the code of its person."""
    known = {name: parameters[name] for name in ('domain', 'option', 'strategy')}
    if 'person' in parameters:
        person = parameters['person']
        return Case(group=person['group'], **known), person['code']
    return Case(group=PEOPLE, **known), parameters['participant']


def _series(case: Case, members: Sequence[tuple[str, Any]]) -> Series:
    length = max(int(point[0]) for _, result in members for point in result['points'])
    values = np.full((1 + len(MEASURES), len(members), length), np.nan)
    for row, (_, result) in enumerate(members):
        for n, *rest in result['points']:  # after "not here" answers, the last of equal n stays
            values[:, row, int(n) - 1] = [np.nan if v is None else v for v in rest]
    return Series(
        case,
        tuple(code for code, _ in members),
        values[1:],
        values[0],
        tuple(result['seconds'] / 60 for _, result in members),
        tuple(result['cut_short'] for _, result in members),
    )
