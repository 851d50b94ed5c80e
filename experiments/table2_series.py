"""What the cells of Table 2 come to: a line for each game and kind of plan."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments.bands import band
from experiments.cells import Cell
from experiments.table2_kinds import Game, GAMES, Kind, KINDS
from experiments.table2_record import SECONDS

Record = Mapping[str, Any]  # one plan


@dataclass(frozen=True)
class Estimate:
    """A mean over people, extractions or repetitions, with its 95 % interval by Student's t."""

    mean: float
    low: float | None  # None: of one value
    high: float | None

    @classmethod
    def of(cls, values: Sequence[float]) -> 'Estimate':
        """Return the estimate from one value or more."""
        found = band(np.array(values, dtype=np.float64)[:, None])
        low, high = (float(limit[0]) for limit in (found.low, found.high))
        if np.isnan(low):
            return cls(float(found.mean[0]), None, None)
        return cls(float(found.mean[0]), low, high)

    @property
    def text(self) -> str:
        """The estimate in words."""
        if self.low is None or self.high is None:
            return f'{self.mean:,.2f}'
        digits = 0 if abs(self.mean) >= 100 else 2
        return f'{self.mean:,.{digits}f} ({self.low:,.{digits}f} to {self.high:,.{digits}f})'


@dataclass(frozen=True)
class Point:
    """One budget of the curve of mean return against planning time."""

    budget: int  # sweeps, or game steps
    seconds: float  # of planning
    value: Estimate  # mean return


@dataclass(frozen=True)
class Line:
    """One kind of plan in one game."""

    game: Game
    kind: Kind
    members: tuple[Mapping[str, Any], ...]  # of each person, extraction or repetition
    costs: tuple[Mapping[str, Any], ...]

    def mean(self, name: str) -> float:
        """Return the mean of a number over all plans of the table."""
        return float(np.mean([plan[name] for one in self.members for plan in one['plans']]))

    @property
    def seconds(self) -> float:
        """What planning took, all counted, on the mean."""
        return sum(self.mean(name) for name in SECONDS)

    def value(self, name: str = 'mean') -> Estimate:
        """Return the mean return, or another number; each member counts once."""
        return Estimate.of(
            [float(np.mean([plan[name] for plan in one['plans']])) for one in self.members]
        )

    def cost(self, name: str) -> float | None:
        """Return the mean cost of getting the options; None: there is none of that kind."""
        known = [cost[name] for cost in self.costs if cost[name] is not None]
        return float(np.mean(known)) if known else None

    @property
    def points(self) -> list[Point]:
        """The curve; where some members have come to an end, they stay as they are."""
        curves = [one['curve'] for one in self.members]
        budgets = sorted({point['budget'] for curve in curves for point in curve})
        return [_point(budget, curves) for budget in budgets]

    def seconds_to_reach(self, level: float) -> float | None:
        """Return the planning seconds of the first point of the curve that is as good."""
        return next((p.seconds for p in self.points if p.value.mean >= level), None)


def _point(budget: int, curves: Sequence[Sequence[Record]]) -> Point:
    at = [max((p for p in curve if p['budget'] <= budget), key=_budget) for curve in curves]
    seconds = float(np.mean([sum(p[name] for name in SECONDS) for p in at]))
    return Point(budget, seconds, Estimate.of([p['mean'] for p in at]))


def _budget(point: Record) -> int:
    budget: int = point['budget']
    return budget


@dataclass(frozen=True)
class Gain:
    """What it gains to carry the same plan out in another way than to the end."""

    game: Game
    kind: Kind  # the other way
    values: tuple[Any, ...]  # of each person: by plan, in games; or least, mean and most by state

    @property
    def games(self) -> Estimate:
        """The gain in games, points; each person counts once."""
        return Estimate.of([float(np.mean(one)) for one in self.values])

    @property
    def states(self) -> NDArray[np.float64]:
        """The gain by state, reward units: least of all, mean, and most."""
        each = np.array([[one['least'], one['mean'], one['most']] for one in self.values])
        return np.array([each[:, 0].min(), each[:, 1].mean(), each[:, 2].max()])


def gather(cells: Sequence[Cell], results: Mapping[str, Any]) -> list[Line]:
    """Return a line for each game and kind that some cell with a result has."""
    known = [results[cell.key] for cell in cells if cell.key in results]
    lines = []
    for game in GAMES:
        for kind in KINDS:
            mine = [r for r in known if kind.name in r['games'].get(game.name, _NO)['kinds']]
            if mine:
                members = tuple(r['games'][game.name]['kinds'][kind.name] for r in mine)
                lines.append(Line(game, kind, members, tuple(r['costs'][kind.name] for r in mine)))
    return lines


_NO: Mapping[str, Any] = {'kinds': {}, 'gains': {}}


def gather_gains(cells: Sequence[Cell], results: Mapping[str, Any]) -> list[Gain]:
    """Return the gains of other ways to carry plans out, by game."""
    known = [results[cell.key] for cell in cells if cell.key in results]
    gains = []
    for game in GAMES:
        for kind in KINDS:
            every = [r['games'].get(game.name, _NO)['gains'].get(kind.name) for r in known]
            values = tuple(value for value in every if value is not None)
            if values:
                gains.append(Gain(game, kind, values))
    return gains
