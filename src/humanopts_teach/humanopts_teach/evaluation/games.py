"""
What plans are worth in games, beside chance and a rule written by hand.

For domains whose plans are estimates from samples. Plans with several sets of options and with
primitive actions play many games, in each of a domain's settings; and their score is followed as
planning is given more time.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
import math
import time
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.capabilities import PlanSettings
from humanopts_env.domains.registry import make_domain
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.planning.action_sets import HUMAN, HUMAN_AND_PRIMITIVE, PRIMITIVE
from humanopts_learner.planning.any_domain import GAME_STEPS
from humanopts_learner.planning.arbitration import Execution
from humanopts_learner.planning.sampled.plan import Sampling
from humanopts_teach.evaluation.comparison import (
    Baseline,
    baselines_of,
    Budgets,
    carried_over,
    compare,
    ComparisonRow,
    CurveRow,
    HEURISTIC,
    PLAN,
    planning_curve,
    RANDOM,
    Report,
    seconds_to_reach,
)

GAMES = 1000  # that everything is judged by
TENFOLD = 10.0  # what is asked of options: the target in a tenth of the primitive actions' time
PATIENCE = 4.0  # s of planning after which options that do not reach the target are given up
CLOCK = time.process_time  # seconds of the processor, which no other program's work makes longer
GENEROUS = 4  # times the game steps, in a second plan with primitive actions

Options = Sequence[LearnedOption]


@dataclass(frozen=True)
class Setting:
    """A variant of the game, and what each way to play came to there."""

    name: str  # such as ghosts=chase; empty: there is but one
    rows: tuple[ComparisonRow, ...]


@dataclass(frozen=True)
class Curve:
    """Score against planning seconds, with one action set."""

    name: str
    rows: tuple[CurveRow, ...]

    def seconds_to_reach(self, target: float) -> float | None:
        """Return the planning seconds of the first plan that reached a score; None: none did."""
        return seconds_to_reach(self.rows, target)

    @property
    def most_seconds(self) -> float:
        """Planning seconds of the longest plan that was tried."""
        return max(row.seconds for row in self.rows)


@dataclass(frozen=True)
class GamesEvaluation:
    """Everything that was found out by playing."""

    games: int  # behind every number
    settings: tuple[Setting, ...]
    curve_setting: str  # where the curves were measured
    curves: tuple[Curve, ...]  # with all options, and with primitive actions
    targets: tuple[float, ...]  # scores of interest; none where nothing is known of the maze

    def to_dict(self) -> dict[str, Any]:
        """Return it as JSON data, without NaN."""
        return {
            'games': self.games,
            'settings': [
                {'name': setting.name, 'rows': [asdict(row) for row in setting.rows]}
                for setting in self.settings
            ],
            'curve_setting': self.curve_setting,
            'curves': [
                {
                    'name': curve.name,
                    'rows': [asdict(row) for row in curve.rows],
                    'seconds_to_reach': [
                        {'score': target, 'seconds': curve.seconds_to_reach(target)}
                        for target in self.targets
                    ],
                }
                for curve in self.curves
            ],
        }


def option_sets(options: Options, fewer: Sequence[str]) -> dict[str, Options]:
    """
    Return what is planned with, by name: all options and, of more, a few of them apart.

    :param fewer: names of the few.
    """
    few = [option for option in options if option.name in fewer]
    sets: dict[str, Options] = {}
    if 0 < len(fewer) == len(few) < len(options):
        sets[_named(few)] = few
    return {**sets, _named(options): options}


def evaluate_games(
    domain: Domain[Any],
    options: Options,
    seed: int,
    games: int = GAMES,
    game_steps: int = GAME_STEPS,
    budgets: Budgets = Budgets(),  # noqa: B008
    progress: Report | None = None,
) -> GamesEvaluation:
    """
    Compare action sets, chance and the domain's rule in games, and measure the curves.

    :param options: of one participant, learned in ``domain`` or in a variant of it.
    :param games: that everything is judged by, two or more.
    :param game_steps: that the plans which are compared are made from.
    :param budgets: of the curves, in game steps.
    :param progress: told what is under way and the share that is done; what it raises passes.
    :raises PlanError: the domain cannot play many games, or the options are of another one.
    """
    variants = _variants(domain)
    parts = PartProgress(progress, len(variants) + 2)
    settings = []
    for name, variant in variants.items():
        contenders = _contenders(variant, options, game_steps)
        rows = compare(variant, contenders, seed, games, progress=parts.begin(name), clock=CLOCK)
        settings.append(Setting(name, tuple(rows)))
    name, variant = next(iter(variants.items()))
    targets = baselines_of(variant).targets
    curves = _curves(variant, options, seed, games, budgets, targets, parts)
    return GamesEvaluation(games, tuple(settings), name, curves, targets)


def _named(options: Options) -> str:
    return f'{len(options)} option{"" if len(options) == 1 else "s"}'


def _variants(domain: Domain[Any]) -> dict[str, Domain[Any]]:
    """Return the settings that a domain is judged in, by name."""
    return {
        name: make_domain(domain.name, {**domain.parameters, **changed})
        for name, changed in baselines_of(domain).variants.items()
    } or {'': domain}


def _contenders(domain: Domain[Any], options: Options, steps: int) -> list[Baseline]:
    usual = baselines_of(domain)
    sets = {
        name: [carried_over(option, domain) for option in chosen]
        for name, chosen in option_sets(options, usual.fewer_options).items()
    }
    found = [
        Baseline(f'human, {name}', PLAN, HUMAN, chosen, steps) for name, chosen in sets.items()
    ]
    found += _interrupted(domain, *list(sets.items())[-1], steps)
    found += [
        _moves('primitive', domain, steps),
        _moves(f'primitive, {GENEROUS}-fold steps', domain, GENEROUS * steps),
        Baseline('random moves', RANDOM, PRIMITIVE),
    ]
    found += [
        Baseline(f'random choice, {name}', RANDOM, HUMAN, chosen) for name, chosen in sets.items()
    ]
    if usual.heuristic is not None:
        found += [
            Baseline('hand-written rule, options to their end', HEURISTIC),
            Baseline('hand-written rule, at every step', HEURISTIC, to_end=False),
        ]
    return found


def _moves(name: str, domain: Domain[Any], steps: int) -> Baseline:
    """Return a plan with primitive actions, with settings that were found by hand."""
    plain = Baseline(name, PLAN, PRIMITIVE, (), steps)
    return _with_settings(plain, baselines_of(domain).primitive)


def _interrupted(domain: Domain[Any], name: str, options: Options, steps: int) -> list[Baseline]:
    """Return the plans that interrupt options, for which there are settings found by hand."""
    usual = baselines_of(domain)
    more = f'human+primitive, {name}, interrupted, {GENEROUS}-fold steps'
    alone = Baseline(f'human, {name}, interrupted', PLAN, HUMAN, options, steps)
    mixture = Baseline(more, PLAN, HUMAN_AND_PRIMITIVE, options, GENEROUS * steps)
    return [
        replace(_with_settings(baseline, settings), execution=Execution.INTERRUPTED)
        for baseline, settings in (
            (alone, usual.interrupted),
            (mixture, usual.interrupted_mixture),
        )
        if settings is not None
    ]


def _with_settings(baseline: Baseline, settings: PlanSettings | None) -> Baseline:
    """Return a plan with settings that were found by hand, where there are any."""
    if settings is None:
        return baseline
    return replace(baseline, gamma=settings.gamma, sampling=Sampling(**settings.sampling))


def _curves(
    domain: Domain[Any],
    options: Options,
    seed: int,
    games: int,
    budgets: Budgets,
    targets: Sequence[float],
    parts: 'PartProgress',
) -> tuple[Curve, ...]:
    """Measure the options, and then primitive actions until they took ten times as long."""
    moved = [carried_over(option, domain) for option in options]
    curves: list[Curve] = []
    measured = (
        Baseline(f'human, {_named(options)}', PLAN, HUMAN, moved),
        _moves(PRIMITIVE, domain, 0),
    )
    for one in measured:
        enough = PATIENCE if not curves else TENFOLD * _needed(curves[0], targets)
        curve_progress = CurveProgress(
            parts.begin('score by planning time'), one.name, budgets, enough
        )
        rows = planning_curve(
            domain,
            one.action_set,
            one.options,
            max(targets, default=math.inf),
            seed,
            budgets,
            games,
            one.sampling,
            one.gamma,
            progress=curve_progress.on_progress,
            on_row=curve_progress.on_row,
            enough_seconds=enough,
            clock=CLOCK,
        )
        curve_progress.end()
        curves.append(Curve(one.name, tuple(rows)))
    return tuple(curves)


def _needed(curve: Curve, targets: Sequence[float]) -> float:
    """Return the seconds to the highest target that was reached; where none was, to the best."""
    reached = [curve.seconds_to_reach(target) for target in sorted(targets, reverse=True)]
    best = max(curve.rows, key=lambda row: row.score.mean).seconds
    return next((seconds for seconds in reached if seconds is not None), best)


class CurveProgress:
    """Progress of a curve by seconds: each plan takes about twice as long as the last."""

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


class PartProgress:
    """The parts of the work, each taken to be as long as any other."""

    def __init__(self, tell: Report | None, count: int) -> None:
        self._tell, self._count, self._begun = tell, count, 0

    def begin(self, name: str) -> Report:
        """Begin the next part, and return its progress callback."""
        before, self._begun = self._begun, self._begun + 1

        def tell(what: str, share: float) -> None:
            if self._tell is not None:
                self._tell(f'{name}: {what}' if name else what, (before + share) / self._count)

        return tell
