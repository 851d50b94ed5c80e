"""
Plans compared in many games with random play and with a rule written by hand.

This is for domains whose plans are made from samples. Plans with several sets of options and with
primitive actions play many games in each variant of a domain. The score of a plan is also measured
as planning is given more time.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
import math
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.capabilities import PlanSettings
from humanopts_env.domains.registry import make_domain
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.planning.request import (
    Execution,
    GAME_STEPS,
    HUMAN,
    HUMAN_AND_PRIMITIVE,
    PRIMITIVE,
    Sampling,
)
from humanopts_teach.evaluation.comparison import (
    Baseline,
    baselines_of,
    carried_over,
    compare,
    ComparisonRow,
    Curve,
    CurveLimits,
    HEURISTIC,
    part_of,
    PLAN,
    planning_curve,
    ProgressCallback,
    RANDOM,
)

GAMES = 1000  # that each way to play is judged by
TENFOLD = 10.0  # what is asked of options: the target in a tenth of the primitive actions' time
PATIENCE = 4.0  # s of planning after which options that do not reach the target are given up
GENEROUS = 4  # times the game steps, in a second plan with primitive actions

Options = Sequence[LearnedOption]


@dataclass(frozen=True)
class Setting:
    """A variant of the game, and the results of each way to play it."""

    name: str  # such as ghosts=chase; empty: there is but one
    rows: tuple[ComparisonRow, ...]


@dataclass(frozen=True)
class GamesEvaluation:
    """The comparison in games and the curves of score against planning time."""

    games: int  # that each way to play was judged by
    settings: tuple[Setting, ...]
    curve_setting: str  # where the curves were measured
    curves: tuple[Curve, ...]  # with all options, and with primitive actions
    targets: tuple[float, ...]  # scores of interest; none where nothing is known of the maze

    def to_dict(self) -> dict[str, Any]:
        """Return it as JSON data, without NaN."""
        values = asdict(self)
        targets = values.pop('targets')
        for curve, plain in zip(self.curves, values['curves']):
            plain['seconds_to_reach'] = [
                {'score': target, 'seconds': curve.seconds_to_reach(target)} for target in targets
            ]
        return values


def option_sets(options: Options, fewer: Sequence[str]) -> dict[str, Options]:
    """
    Return the sets of options to plan with, by name: all and, where there are more, a few apart.

    :param fewer: names of the few.
    """
    few = [option for option in options if option.name in fewer]
    apart = 0 < len(fewer) == len(few) < len(options)
    return {_counted(each): each for each in ([few, options] if apart else [options])}


def _counted(options: Options) -> str:
    return f'{len(options)} option{"" if len(options) == 1 else "s"}'


def evaluate_games(
    domain: Domain[Any],
    options: Options,
    seed: int,
    games: int = GAMES,
    game_steps: int = GAME_STEPS,
    limits: CurveLimits = CurveLimits(),  # noqa: B008
    progress: ProgressCallback | None = None,
) -> GamesEvaluation:
    """
    Compare action sets, chance and the domain's rule in games, and measure the curves.

    The second curve, with primitive actions, goes on until planning took ten times as long as the
    options needed.

    :param options: of one participant, learned in ``domain`` or in a variant of it.
    :param games: that each way to play is judged by, two or more.
    :param game_steps: that the plans which are compared are made from.
    :param limits: of the budgets of the curves; the scores of interest are added.
    :param progress: called as the work goes on; what it raises passes through.
    :raises PlanError: the domain cannot play many games, or the options are of another one.
    """
    variants = {
        name: make_domain(domain.name, {**domain.parameters, **changed})
        for name, changed in baselines_of(domain).variants.items()
    } or {'': domain}
    parts = len(variants) + 2
    settings = []
    for number, (name, variant) in enumerate(variants.items()):
        report = part_of(progress, number, parts, name)
        rows = compare(variant, _baselines(variant, options, game_steps), seed, games, report)
        settings.append(Setting(name, tuple(rows)))
    name, variant = next(iter(variants.items()))
    usual = baselines_of(variant)
    moved = [carried_over(option, variant) for option in options]
    measured = (
        Baseline(f'human, {_counted(options)}', PLAN, HUMAN, moved),
        _planned(PRIMITIVE, PRIMITIVE, (), 0, usual.primitive),
    )
    limits = replace(limits, target=max(usual.targets, default=math.inf))
    curves: list[Curve] = []
    for number, baseline in enumerate(measured, start=len(variants)):
        enough = TENFOLD * _needed(curves[0], usual.targets) if curves else PATIENCE
        report = part_of(progress, number, parts, 'score by planning time')
        limited = replace(limits, enough_seconds=enough)
        curves.append(planning_curve(variant, baseline, limited, seed, games, report))
    return GamesEvaluation(games, tuple(settings), name, tuple(curves), usual.targets)


def _baselines(domain: Domain[Any], options: Options, steps: int) -> list[Baseline]:
    """Return everything that plays in one variant of the game."""
    usual = baselines_of(domain)
    moved = [carried_over(option, domain) for option in options]
    sets = option_sets(moved, usual.fewer_options)
    every = _counted(options)
    mixture = f'human+primitive, {every}, interrupted, {GENEROUS}-fold steps'
    found = [_planned(f'human, {name}', HUMAN, chosen, steps) for name, chosen in sets.items()]
    for name, action_set, fold, settings in (
        (f'human, {every}, interrupted', HUMAN, 1, usual.interrupted),
        (mixture, HUMAN_AND_PRIMITIVE, GENEROUS, usual.interrupted_mixture),
    ):
        if settings is not None:
            plan = _planned(name, action_set, moved, fold * steps, settings)
            found.append(replace(plan, execution=Execution.INTERRUPTED))
    many = f'primitive, {GENEROUS}-fold steps'
    found += [
        _planned('primitive', PRIMITIVE, (), steps, usual.primitive),
        _planned(many, PRIMITIVE, (), GENEROUS * steps, usual.primitive),
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


def _planned(
    name: str,
    action_set: str,
    options: Options,
    steps: int,
    settings: PlanSettings | None = None,
) -> Baseline:
    """Return a plan, with the settings that were found by hand where there are any."""
    plan = Baseline(name, PLAN, action_set, options, steps)
    if settings is None:
        return plan
    return replace(plan, gamma=settings.gamma, sampling=Sampling(**settings.sampling))


def _needed(curve: Curve, targets: Sequence[float]) -> float:
    """Return the seconds to the highest target that was reached; where none was, to the best."""
    reached = [curve.seconds_to_reach(target) for target in sorted(targets, reverse=True)]
    best = max(curve.rows, key=lambda row: row.score.mean).seconds
    return next((seconds for seconds in reached if seconds is not None), best)
