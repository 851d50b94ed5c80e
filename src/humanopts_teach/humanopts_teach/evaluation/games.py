"""
Plans compared in many games with random play and with a rule written by hand.

This is for domains whose plans are made from samples. Plans with several sets of options and with
primitive actions play many games in each variant of a domain. Baselines are random choice among
the options that can start, and a heuristic written by hand where the domain has one; each plays as
many games under the same rules.

The curve of score against planning time has the same protocol for every action set. A plan is made
from a budget of game steps and judged in new games. The budget is doubled until the 95 % interval
of the mean score lies at or above the target, or the largest budget is spent, or planning has
taken as long as anyone wants to wait. Planning seconds are those of the processor, for one plan
made from scratch, models counted; judging is not.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import lru_cache, partial
import math
import time
from typing import Any

from humanopts_env.arrays import Floats
from humanopts_env.domains.base import Domain
from humanopts_env.domains.capabilities import Baselines, HasBaselines, PlanSettings, Scores
from humanopts_env.domains.registry import make_domain, parameters_json
from humanopts_learner.intervals import Interval, level_of_each
from humanopts_learner.options.files import option_to_json
from humanopts_learner.options.option import LearnedOption, OptionError
from humanopts_learner.planning.evaluate import Returns
from humanopts_learner.planning.plan import judge_plan, Performance
from humanopts_learner.planning.request import (
    Execution,
    GAME_STEPS,
    HUMAN,
    HUMAN_AND_PRIMITIVE,
    PlanError,
    PlanRequest,
    PRIMITIVE,
    Sampling,
)
from humanopts_learner.planning.sampled.action_set import ActionSet
from humanopts_learner.planning.sampled.games import play_games
from humanopts_learner.planning.sampled.plan import make_sampled_plan, SampledPlan
from humanopts_learner.planning.sampled.policies import UniformPolicy
from humanopts_teach.bags.reader import ignore_progress
from humanopts_teach.evaluation.side_by_side import all_of, Meanwhile
import numpy as np

GAMES = 1000  # that each way to play is judged by
TENFOLD = 10.0  # what is asked of options: the target in a tenth of the primitive actions' time
PATIENCE = 4.0  # s of planning after which options that do not reach the target are given up
BUDGETS = tuple(12_500 * 2**n for n in range(12))  # game steps, of the plans of a curve
GENEROUS = 4  # times the game steps, in a second plan with primitive actions
CURVE = 'score by planning time'
PLAYING = 50_000  # game steps that take about as long as to judge a way to play
MIXED = 2  # times as long: a plan with options and primitive actions
PLAN, RANDOM, HEURISTIC = 'plan', 'chance', 'rule'  # kinds of baseline, as in summary.json

Options = Sequence[LearnedOption]
ProgressCallback = Callable[[float, float, str], object]  # done, total, what is under way
PlayKey = tuple[Any, ...]  # what the results of a way to play depend on


@dataclass(frozen=True)
class Baseline:
    """One way to play."""

    name: str
    kind: str  # PLAN, RANDOM or HEURISTIC
    action_set: str = HUMAN  # of PLAN and RANDOM
    options: Sequence[LearnedOption] = ()  # of PLAN and RANDOM
    budget_steps: int = 0  # game steps that the plan is made from
    gamma: float | None = None  # of the plan; None: the domain's own
    sampling: Sampling = field(default_factory=Sampling)  # of the plan
    execution: Execution = Execution.RUN_TO_END  # of the plan
    to_end: bool = True  # HEURISTIC: options run to their end; False: one is chosen at every step

    @property
    def needs_options(self) -> bool:
        """Whether it plays with options that were learned."""
        return self.kind != HEURISTIC and self.action_set != PRIMITIVE


@dataclass(frozen=True)
class ComparisonRow:
    """Results of one way to play."""

    name: str
    kind: str
    options: tuple[str, ...]  # names of the learned ones that it chooses among
    games: int
    score: Interval
    outcomes: Mapping[str, Interval]  # that the domain reports; shares, or means
    decisions: float | None = None  # options begun in a game, mean; None: not counted
    fallbacks: float | None = None  # decisions for a primitive action: no option could start
    game_steps: int = 0  # that planning sampled
    seconds: float | None = None  # of planning; None: nothing was planned
    n_states: int = 0  # abstract states that planning visited; not in JSON data
    scores: Floats = field(default_factory=lambda: np.zeros(0), compare=False, repr=False)
    """(E,) of each game, not in JSON data."""


def baselines_of(domain: Domain[Any]) -> Baselines:
    """Return the baselines of a domain; none where it does not name any."""
    return domain.baselines() if isinstance(domain, HasBaselines) else Baselines()


def carried_over(option: LearnedOption, domain: Domain[Any]) -> LearnedOption:
    """
    Return an option that was learned in the same game with other parameters, for use in this one.

    :raises PlanError: another game, or its features or actions are others there.
    """
    moved = replace(option, domain_parameters=parameters_json(domain))
    try:
        moved.check_domain(domain)
    except OptionError as error:
        raise PlanError(str(error)) from error
    return moved


def play_baseline(
    domain: Domain[Any], baseline: Baseline, seed: int, games: int = 1000
) -> ComparisonRow:
    """
    Play games in one way.

    :param seed: of the plan, and of the games, which are drawn independently.
    :param games: two or more.
    :raises PlanError: as ``make_sampled_plan``; or the domain has no rule written by hand.
    """
    if baseline.kind == PLAN:
        request = PlanRequest(
            baseline.action_set,
            gamma=baseline.gamma or 0.0,
            game_steps=baseline.budget_steps,
            seed=seed,
            sampling=baseline.sampling,
            execution=baseline.execution,
        )
        clock = time.process_time  # no other program's work makes it longer
        plan = make_sampled_plan(domain, baseline.options, request, clock=clock)
        return _plan_row(baseline, plan, judge_plan(plan, seed, games))
    results: Returns | Scores
    counts: dict[str, Any] = {}
    if baseline.kind == RANDOM:
        actions = ActionSet(domain, baseline.action_set, baseline.options)
        results = play_games(actions, UniformPolicy(actions), domain.gamma, seed, games)
        counts['decisions'] = float(results.decisions.mean())
        counts['fallbacks'] = float(results.fallbacks.mean())
    elif (play := baselines_of(domain).heuristic) is not None:
        results = play(games, seed, to_end=baseline.to_end)
    else:
        raise PlanError(f'{domain.name} has no rule that was written by hand')
    return ComparisonRow(
        name=baseline.name,
        kind=baseline.kind,
        options=tuple(option.name for option in baseline.options),
        games=games,
        score=Interval.of(results.total),
        scores=results.total,
        outcomes={name: Interval.of(values) for name, values in results.outcomes.items()},
        **counts,
    )


def judged_plan(
    plan: SampledPlan, judged: Performance, seed: int
) -> tuple[PlayKey, ComparisonRow]:
    """Return what ``play_baseline`` would of a plan with the usual settings that was judged."""
    way = Baseline('', PLAN, plan.action_set, plan.actions.options, plan.game_steps)
    return _key(plan.domain, way, seed, judged.episodes), _plan_row(way, plan, judged)


def _plan_row(way: Baseline, plan: SampledPlan, judged: Performance) -> ComparisonRow:
    return ComparisonRow(
        name=way.name,
        kind=way.kind,
        options=tuple(option.name for option in way.options),
        games=judged.episodes,
        score=judged.total,
        scores=judged.totals,
        outcomes=judged.outcomes,
        decisions=judged.decisions / judged.episodes,
        fallbacks=judged.fallbacks / judged.episodes,
        game_steps=plan.game_steps,
        seconds=plan.seconds,
        n_states=len(plan.solution.values),
    )


@dataclass(frozen=True)
class CurveRow:
    """One plan and its score."""

    action_set: str
    budget_steps: int
    seconds: float  # of planning
    score: Interval
    n_states: int  # abstract states that were visited


@dataclass(frozen=True)
class Curve:
    """Score against planning seconds, with one action set."""

    name: str
    rows: tuple[CurveRow, ...]

    def seconds_to_reach(self, target: float) -> float | None:
        """Return the planning seconds of the first plan that reached a score; None: none did."""
        return next((row.seconds for row in self.rows if row.score.low >= target), None)

    def reached(self, target: float) -> str:
        """Return the planning time until a score was reached, in words."""
        seconds = self.seconds_to_reach(target)
        if seconds is None:
            return f'not reached in {max(row.seconds for row in self.rows):.1f} s'
        return f'in {seconds:.1f} s'

    def times_as_long(self, other: 'Curve', target: float) -> Interval | None:
        """
        Return how many times as long as the other this takes to reach a score; None: it cannot.

        Either is known to reach it with the first plan whose whole interval does, and not to
        reach it with plans whose whole interval lies below. So the limits are those of the
        budgets that were tried; infinite: this one never reached it.
        """
        slow, quick = self.seconds_to_reach(target), other.seconds_to_reach(target)
        if quick is None:
            return None
        short, long = self._too_short(target), other._too_short(target)
        least = max(row.seconds for row in self.rows) if slow is None else slow
        most = slow / long if slow is not None and long else math.inf
        return Interval(least / quick, short / quick, most)

    def _too_short(self, target: float) -> float:
        """Return the planning seconds of the longest plan that scores below for certain, or 0."""
        low = (row.seconds for row in self.rows if row.score.at_least(target) is False)
        return max(low, default=0.0)


def planning_curve(
    domain: Domain[Any],
    baseline: Baseline,
    budgets: Sequence[int],
    seed: int,
    games: int = 1000,
    *,
    target: float = math.inf,
    enough_seconds: float = math.inf,
    known: Mapping[int, ComparisonRow] = {},
) -> Curve:
    """
    Make plans from budget after budget, and judge each.

    :param baseline: a plan; its own budget is not used.
    :param budgets: of game steps, ascending.
    :param target: mean score that is enough.
    :param enough_seconds: no larger budget is tried once a plan took so long.
    :param seed: of the plans, and of the games, which are drawn independently.
    :param games: that each plan is judged by, two or more.
    :param known: what ``play_baseline`` has returned for some of the budgets.
    :raises PlanError: as ``make_sampled_plan``.
    """
    rows: list[CurveRow] = []
    for budget in budgets:
        way = replace(baseline, budget_steps=budget)
        row = known.get(budget) or play_baseline(domain, way, seed, games)
        assert row.seconds is not None, 'it was planned'
        rows.append(CurveRow(baseline.action_set, budget, row.seconds, row.score, row.n_states))
        if row.score.low >= target or row.seconds >= enough_seconds:
            break
    return Curve(baseline.name, tuple(rows))


@dataclass(frozen=True)
class Setting:
    """A variant of the game, and the results of each way to play it."""

    name: str  # such as ghosts=chase; empty: there is but one
    rows: tuple[ComparisonRow, ...]

    def largest(self, kind: str) -> ComparisonRow:
        """Return the row of the largest set of options, of one kind."""
        return max((row for row in self.rows if row.kind == kind), key=lambda r: len(r.options))

    @property
    def gain(self) -> Interval:
        """What the plan with all options scores more than random choice among them, by game."""
        return Interval.of_difference(self.largest(PLAN).scores, self.largest(RANDOM).scores)

    @property
    def over_rule(self) -> tuple[ComparisonRow, ComparisonRow, Interval] | None:
        """
        Return the best plan with options alone, the best rule, and what the plan scores more.

        Both are the best by their means, so the interval holds for every such plan and rule at
        once. None: there is no rule.
        """
        plans = [row for row in self.rows if row.kind == PLAN and row.name.startswith(f'{HUMAN},')]
        rules = [row for row in self.rows if row.kind == HEURISTIC]
        if not plans or not rules:
            return None
        plan, rule = (max(rows, key=lambda row: row.score.mean) for rows in (plans, rules))
        level = level_of_each(len(plans) * len(rules))
        return plan, rule, Interval.of_difference(plan.scores, rule.scores, level)


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
        for setting, plain in zip(self.settings, values['settings']):
            plain['gain_over_chance'] = asdict(setting.gain)
            over = setting.over_rule
            plain['over_rule'] = over and {
                'plan': over[0].name,
                'rule': over[1].name,
                **asdict(over[2]),
            }
            for row in plain['rows']:
                del row['scores'], row['n_states']
        for curve, plain in zip(self.curves, values['curves']):
            plain['seconds_to_reach'] = [
                {'score': target, 'seconds': curve.seconds_to_reach(target)} for target in targets
            ]
        return values


def option_sets(options: Options, fewer: Sequence[Sequence[str]]) -> dict[str, Options]:
    """
    Return the sets of options to plan with, by name: smaller ones that are complete, then all.

    :param fewer: names of the options of each smaller set.
    """
    few = [[option for option in options if option.name in names] for names in fewer]
    apart = [each for names, each in zip(fewer, few) if 0 < len(names) == len(each) < len(options)]
    return {_counted(each): each for each in (*apart, options)}


def _counted(options: Options) -> str:
    return f'{len(options)} option{"" if len(options) == 1 else "s"}'


def evaluate_games(
    domain: Domain[Any],
    options: Options,
    seed: int,
    games: int = GAMES,
    game_steps: int = 0,
    budgets: Sequence[int] = BUDGETS,
    progress: ProgressCallback = ignore_progress,
    jobs: int = 0,
    known: Mapping[PlayKey, ComparisonRow] = {},
    earlier: Meanwhile[PlayKey, Any] | None = None,
) -> GamesEvaluation:
    """
    Compare action sets, chance and the domain's rule in games, and measure the curves.

    :param options: of one participant, learned in ``domain`` or in a variant of it.
    :param games: that each way to play is judged by, two or more.
    :param game_steps: that the plans which are compared are made from; 0: as many as is usual.
    :param budgets: of the curves, game steps, ascending.
    :param progress: called as the work goes on; what it raises passes through.
    :param jobs: processes that do the work; 0: one for each core; 1: this one.
    :param known: what ``earlier_calls`` or ``judged_plan`` came to, some of it.
    :param earlier: has begun some of them, and does what is left; None: ``jobs`` do.
    :raises PlanError: the domain cannot play many games, or the options are of another one.
    """
    variants = _variants(domain)
    first, variant = next(iter(variants.items()))
    usual = baselines_of(variant)
    steps = game_steps or GAME_STEPS
    compared = _compared(variants, options, steps)
    curve = _primitive_plans(variant, budgets, steps)
    plays = _plays(variants, compared, curve, seed, games)
    known = {**known, **(earlier.results if earlier else {})}
    rows = {key: row for key, row in known.items() if key in plays}
    left = {key: play for key, play in plays.items() if key not in rows}
    calls: dict[PlayKey, Callable[[], Any]] = {
        key: partial(play_baseline, variants[name], way, seed, games)
        for key, (name, way) in left.items()
    }
    calls |= _curve_of_options(variant, options, budgets, seed, games)
    names = [*(f'{name}: {way.name}' if name else way.name for name, way in left.values()), CURVE]
    costs = [*(_cost(way) for _, way in left.values()), math.inf]
    progress(0, len(calls), f'{len(calls)} parts, side by side')
    if earlier:
        *found, human = earlier.all_of(calls, names, costs, progress)
    else:
        *found, human = all_of([*calls.values()], names, costs, progress, jobs)
    rows |= zip(left, found)

    def row_of(of: Domain[Any], way: Baseline) -> ComparisonRow:
        return replace(rows[_key(of, way, seed, games)], name=way.name)

    settings = tuple(
        Setting(name, tuple(row_of(each, way) for way in compared[name]))
        for name, each in variants.items()
    )
    primitive = planning_curve(
        *(variant, _planned(PRIMITIVE, PRIMITIVE, (), 0, usual.primitive), budgets, seed, games),
        target=_target(usual),
        enough_seconds=TENFOLD * _needed(human, usual.targets),
        known={budget: row_of(variant, way) for budget, way in curve.items()},
    )
    return GamesEvaluation(games, settings, first, (human, primitive), usual.targets)


def earlier_calls(
    domain: Domain[Any],
    options: Options,
    seed: int,
    games: int = GAMES,
    game_steps: int = 0,
    budgets: Sequence[int] = BUDGETS,
) -> dict[PlayKey, Callable[[], Any]]:
    """
    Return calls of ``evaluate_games`` that can be made before it, the costliest first.

    The plan with all options that a bag is evaluated with is not among them: it is known then.
    Parameters and errors are those of ``evaluate_games``.

    :param options: the calls need all of them, or some; none: calls that need no options.
    """
    variants, steps = _variants(domain), game_steps or GAME_STEPS
    first = next(iter(variants.values()))
    curve = _primitive_plans(first, budgets, steps)
    plays = _plays(variants, _compared(variants, options, steps), curve, seed, games)
    plays.pop(_key(domain, Baseline('', PLAN, HUMAN, options, steps), seed, games), None)
    calls = _curve_of_options(first, options, budgets, seed, games) if options else {}
    return calls | {
        key: partial(play_baseline, variants[name], way, seed, games)
        for key, (name, way) in sorted(plays.items(), key=lambda play: -_cost(play[1][1]))
        if way.needs_options == bool(options)
    }


def _compared(
    variants: Mapping[str, Domain[Any]], options: Options, steps: int
) -> dict[str, list[Baseline]]:
    """Return the ways to play that are compared in each variant."""
    return {name: every_baseline(each, options, steps) for name, each in variants.items()}


def _plays(
    variants: Mapping[str, Domain[Any]],
    compared: Mapping[str, Sequence[Baseline]],
    curve: Mapping[int, Baseline],
    seed: int,
    games: int,
) -> dict[PlayKey, tuple[str, Baseline]]:
    """
    Return the variant and the way of each play; what plays alike does so once.

    :param curve: ways to play in the first of the variants.
    """
    ways = [*((name, way) for name, each in compared.items() for way in each)]
    ways += [(next(iter(variants)), way) for way in curve.values()]
    plays: dict[PlayKey, tuple[str, Baseline]] = {}
    for name, way in ways:
        plays.setdefault(_key(variants[name], way, seed, games), (name, way))
    return plays


def _variants(domain: Domain[Any]) -> dict[str, Domain[Any]]:
    """Return the variants of a game by name; the curves are measured in the first."""
    return {
        name: make_domain(domain.name, {**domain.parameters, **changed})
        for name, changed in baselines_of(domain).variants.items()
    } or {'': domain}


def _key(domain: Domain[Any], way: Baseline, seed: int, games: int) -> PlayKey:
    """Return what the results of a way to play depend on."""
    parts = {each.name: getattr(way, each.name) for each in fields(way) if each.name != 'name'}
    parts['options'] = tuple(map(_contents, way.options))
    return (domain.name, parameters_json(domain), seed, games, *parts.values())


@lru_cache(maxsize=64)
def _contents(option: LearnedOption) -> str:
    return option_to_json(option)


def _cost(way: Baseline) -> float:
    """Return about how many game steps of a plan with one kind of action take as long."""
    mixed = way.action_set not in (HUMAN, PRIMITIVE)
    return way.budget_steps * (MIXED if mixed else 1) + PLAYING


def _target(usual: Baselines) -> float:
    """Return the score at which a curve ends."""
    return max(usual.targets, default=math.inf)


def _primitive_plans(
    domain: Domain[Any], budgets: Sequence[int], steps: int
) -> dict[int, Baseline]:
    """
    Return plans with primitive actions by budget, up to the largest of those that are compared.

    Where their curve ends decides what options need, so some may turn out not to belong to it.
    """
    settings = baselines_of(domain).primitive
    return {
        budget: _planned(f'{CURVE}, {PRIMITIVE}, {budget:,}', PRIMITIVE, (), budget, settings)
        for budget in budgets
        if budget <= GENEROUS * steps
    }


def _curve_of_options(
    domain: Domain[Any], options: Options, budgets: Sequence[int], seed: int, games: int
) -> dict[PlayKey, Callable[[], Curve]]:
    """Return the call that measures the curve of all options, by what its result depends on."""
    moved = [carried_over(option, domain) for option in options]
    of_options = Baseline(f'human, {_counted(options)}', PLAN, HUMAN, moved)
    key = *_key(domain, of_options, seed, games), *budgets
    target = _target(baselines_of(domain))
    curve = partial(planning_curve, target=target, enough_seconds=PATIENCE)
    return {key: partial(curve, domain, of_options, budgets, seed, games)}


def every_baseline(domain: Domain[Any], options: Options, steps: int) -> list[Baseline]:
    """
    Return everything that plays in one variant of the game.

    :param options: learned in ``domain`` or in a variant of it.
    :param steps: game steps that a plan is made from.
    :raises PlanError: the options are of another game.
    """
    usual = baselines_of(domain)
    moved = [carried_over(option, domain) for option in options]
    sets = option_sets(moved, usual.fewer_options)
    fold = f'{GENEROUS}-fold steps'
    many = f'{_counted(options)}, interrupted, {fold}'
    mixture = usual.interrupted_mixture
    found = [_planned(f'human, {name}', HUMAN, chosen, steps) for name, chosen in sets.items()]
    interrupted: list[tuple[str, str, Options, int, PlanSettings | None]] = [
        *(
            (f'human, {name}, interrupted', HUMAN, chosen, steps, usual.interrupted)
            for name, chosen in sets.items()
        ),
        (f'human, {many}', HUMAN, moved, GENEROUS * steps, usual.interrupted),
        (f'human+primitive, {many}', HUMAN_AND_PRIMITIVE, moved, GENEROUS * steps, mixture),
    ]
    found += [
        replace(_planned(*plan), execution=Execution.INTERRUPTED)
        for plan in interrupted
        if plan[-1] is not None
    ]
    found += [
        _planned('primitive', PRIMITIVE, (), steps, usual.primitive),
        _planned(f'primitive, {fold}', PRIMITIVE, (), GENEROUS * steps, usual.primitive),
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
