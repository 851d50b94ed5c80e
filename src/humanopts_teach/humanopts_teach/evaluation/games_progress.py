"""How far the games of an evaluation are."""

import math

from humanopts_teach.evaluation.comparison import Budgets, CurveRow, Report


class CurveTeller:
    """Tells how far a curve is, by seconds: each plan takes about twice as long as the last."""

    def __init__(self, tell: Report, name: str, budgets: Budgets, enough: float) -> None:
        self._tell, self._name, self._enough = tell, name, enough
        self._left = iter(budgets)
        self._budget, self._seconds, self._share = next(self._left), 0.0, 0.0

    def on_progress(self, stage: str, fraction: float, sweeps: int, residual: float) -> None:
        """Report how far a plan is."""
        if stage == 'models':
            self._say(f'{self._name}, {self._budget:,} game steps', (1 + fraction) * self._seconds)

    def on_row(self, row: CurveRow) -> None:
        """Report what a plan came to."""
        mean, steps = row.score.mean, f'{row.budget_steps:,}'
        self._seconds, self._budget = row.seconds, next(self._left, self._budget)
        self._say(f'{self._name}, {steps} game steps: score {mean:,.0f}', row.seconds)

    def end(self) -> None:
        """Report that there is no more to come."""
        self._say(f'{self._name}: done', math.inf)

    def _say(self, what: str, seconds: float) -> None:
        self._share = max(self._share, min(seconds / self._enough, 1.0))
        self._tell(what, self._share)


class Parts:
    """The parts of the work, each taken to be as long as any other."""

    def __init__(self, tell: Report | None, count: int) -> None:
        self._tell, self._count, self._begun = tell, count, 0

    def begin(self, name: str) -> Report:
        """Begin the next part; return what tells how far it is."""
        before, self._begun = self._begun, self._begun + 1

        def tell(what: str, share: float) -> None:
            if self._tell is not None:
                self._tell(f'{name}: {what}' if name else what, (before + share) / self._count)

        return tell
