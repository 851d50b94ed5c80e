"""
Comparison of policies in many games of a domain with sampled models.

The policies are the paper's plans (with its participants' options and with primitive actions),
plans with all options, random choice among the options and, if the domain has one, a hand-written
rule. All policies play the same number of games in each variant of the game.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
import time
from typing import Any, TYPE_CHECKING

from humanopts_env.arrays import Flags, Ints
from humanopts_env.domains.base import Domain
from humanopts_env.domains.capabilities import Baselines, HasBaselines
from humanopts_env.domains.registry import make_domain, parameters_json
from humanopts_env.games import Games, new_games
from humanopts_env.seeding import generator
from humanopts_learner.execution import Fixed, play
from humanopts_learner.intervals import Interval
from humanopts_learner.options.learned_option import LearnedOption, OptionError
from humanopts_learner.planning.action_set import ActionSet, AnyOption
from humanopts_learner.planning.exact_plan import Returns
from humanopts_learner.planning.plan import AnyPlan, judge_plan, Performance
from humanopts_learner.planning.request import (
    Arbitration,
    HUMAN,
    PlanError,
    PlanRequest,
    PRIMITIVE,
    usual_game_steps,
)
from humanopts_learner.planning.sampled_plan import make_sampled_plan, play_games
from humanopts_teach.bags.mcap_file import ignore_progress
from humanopts_teach.evaluation import ProgressCallback
from humanopts_teach.evaluation.side_by_side import all_of, Jobs
from humanopts_teach.evaluation.tables import finite_parts, records, table
from humanopts_teach.evaluation.tables import GAMES as COLUMNS
import numpy as np

if TYPE_CHECKING:
    import pandas as pd  # slow to import

GAMES, REPLAYED_GAMES = 1000, 100  # per policy; the latter if worlds step one by one
FOLD = 4  # multiplies the game steps for a second plan with all options
PLAYING = 50_000  # sampled game steps that take about as long as evaluating a policy
PLAN, RANDOM, RULE = 'plan', 'chance', 'rule'  # kinds of baseline
RULE_NAME = 'hand-written rule'
HUMAN_PLAN = PlanRequest(HUMAN)


@dataclass(frozen=True)
class Baseline:
    """One policy to compare."""

    name: str
    kind: str  # PLAN, RANDOM or RULE
    options: Sequence[LearnedOption] = ()  # for PLAN and RANDOM
    request: PlanRequest = HUMAN_PLAN  # for PLAN; RANDOM uses only the action set


def gains(games: 'pd.DataFrame') -> 'pd.DataFrame':
    """
    Return the score gains of plans over random choice and over the rule, paired by game.

    :param games: table of ``evaluate_games``.
    :return: columns setting, name, less (name of the other policy), mean, low, high (95 %
        interval). Random choice is compared with the first plan with all options, run to their
        ends; the rule is compared with the last plan with all options.
    """
    import pandas as pd

    found = []
    for setting, rows in games.groupby('setting', sort=False):
        scores, kinds = rows.set_index('name')['scores'], rows.set_index('name')['kind']
        sizes = rows.set_index('name')['options'].str.len()[kinds == PLAN]
        plans = sizes.index[sizes == sizes.max()]
        for plan, kind in ((plans[0], RANDOM), (plans[-1], RULE)):
            for other in kinds.index[kinds == kind]:
                more = Interval.of_difference(scores[plan], scores[other])
                found.append([setting, plan, other, more.mean, more.low, more.high])
    return pd.DataFrame(found, columns=['setting', 'name', 'less', 'mean', 'low', 'high'])


def games_to_dict(games: 'pd.DataFrame') -> dict[str, Any]:
    """Return the rows and gains of ``evaluate_games`` as JSON data."""
    return {'rows': records(games[[*COLUMNS]]), 'gains': records(gains(games))}


def baselines_of(domain: Domain) -> Baselines:
    """Return the baselines of a domain; empty if it defines none."""
    return domain.baselines() if isinstance(domain, HasBaselines) else Baselines()


def carried_over(option: LearnedOption, domain: Domain) -> LearnedOption:
    """
    Adapt an option learned with other parameters of the same game to this domain.

    :raises PlanError: the game, its features or its actions differ.
    """
    moved = replace(option, domain_parameters=parameters_json(domain))
    try:
        moved.check_domain(domain)
    except OptionError as error:
        raise PlanError(str(error)) from error
    return moved


def play_baseline(
    domain: Domain,
    baseline: Baseline,
    seed: int,
    games: int = GAMES,
    known: tuple[AnyPlan, Performance] | None = None,
) -> dict[str, Any]:
    """
    Play games with a policy.

    :param seed: seed of the plan and of the games, which are drawn independently.
    :param games: number of games, two or more.
    :param known: plan of the baseline, made and evaluated with the same seed; None: make one.
    :return: columns ``GAMES`` without the setting, and the scores of the games (E,).
    :raises PlanError: as in ``make_sampled_plan``, or the domain has no hand-written rule.
    """
    if baseline.kind == PLAN:
        if known is None:
            request = replace(baseline.request, seed=seed)
            clock = time.process_time  # unaffected by other programs
            plan: AnyPlan = make_sampled_plan(domain, baseline.options, request, clock=clock)
            known = plan, judge_plan(plan, seed, games)
        plan, judged = known
        scores, outcomes = judged.totals, judged.outcomes
        counts = {'decisions': judged.decisions / games, 'fallbacks': judged.fallbacks / games}
        counts |= {'game_steps': plan.game_steps, 'seconds': plan.seconds}
    else:
        if baseline.kind == RANDOM:
            actions = ActionSet(domain, baseline.request.action_set, baseline.options)
            policy = AnyOption(generator(seed, 'random choice'))
            returns = play_games(actions, policy, domain.gamma, seed, games)
            counts = {'decisions': returns.decisions.mean(), 'fallbacks': returns.fallbacks.mean()}
        elif (rule := baselines_of(domain).heuristic) is not None:
            rng, moves = generator(seed, 'hand-written rule'), Moves(rule)
            begun, once = new_games(domain, games, rng), Fixed(np.zeros(games, dtype=np.intp))
            returns = Returns.of(play(begun, moves, once, rng, domain.max_steps), domain.gamma, 1)
            counts = {}
        else:
            raise PlanError(f'{domain.name} has no hand-written rule')
        scores = returns.total
        outcomes = {name: Interval.of(values) for name, values in returns.outcomes.items()}
    score = Interval.of(scores)
    return {
        'name': baseline.name,
        'kind': baseline.kind,
        'options': [option.name for option in baseline.options],
        'games': games,
        'score': score.mean,
        'score_low': score.low,
        'score_high': score.high,
        'outcomes': {name: finite_parts(each) for name, each in outcomes.items()},
        'game_steps': 0,
        **counts,
        'scores': scores,
    }


@dataclass(frozen=True)
class Moves:
    """The actions of a hand-written rule as one option that ends after every step."""

    rule: Callable[[Games], Ints]
    actions: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.intp))  # (N,)
    limits: Ints = field(default_factory=lambda: np.ones(1, dtype=np.intp))

    def see(self, games: Games) -> 'Moves':
        return replace(self, actions=self.rule(games))

    def take(self, games: Ints) -> 'Moves':
        return replace(self, actions=self.actions.take(games))

    def action(self, option: Ints) -> Ints:
        return self.actions

    def ends(self, option: Ints) -> Flags:
        return np.ones(len(option), dtype=np.bool_)


def every_baseline(domain: Domain, options: Sequence[LearnedOption], steps: int) -> list[Baseline]:
    """
    Return the policies to compare in one variant of the game.

    :param options: options learned in ``domain`` or in a variant of it.
    :param steps: game steps per plan.
    :raises PlanError: the options belong to another game.
    """
    usual = baselines_of(domain)
    moved = [carried_over(option, domain) for option in options]
    papers = [option for option in moved if option.name in usual.paper_options]
    count = f'{len(moved)} option{"" if len(moved) == 1 else "s"}'
    human = PlanRequest(HUMAN, game_steps=steps)
    found = [Baseline(f'human, {count}', PLAN, moved, human)]
    if 0 < len(usual.paper_options) == len(papers) < len(moved):
        found.insert(0, Baseline(f'human, {len(papers)} options', PLAN, papers, human))
    stopped = PlanRequest(HUMAN, game_steps=FOLD * steps, execution=Arbitration.INTERRUPTED)
    found.append(Baseline(f'human, {count}, interrupted, {FOLD}-fold steps', PLAN, moved, stopped))
    primitive = PlanRequest(PRIMITIVE, game_steps=steps)
    found.append(Baseline(PRIMITIVE, PLAN, (), primitive))
    found.append(Baseline(f'random choice, {count}', RANDOM, moved))
    return found if usual.heuristic is None else [*found, Baseline(RULE_NAME, RULE)]


def evaluate_games(
    domain: Domain,
    options: Sequence[LearnedOption],
    seed: int,
    games: int = GAMES,
    game_steps: int = 0,
    progress: ProgressCallback = ignore_progress,
    jobs: Jobs = 0,
    known: tuple[AnyPlan, Performance] | None = None,
) -> 'pd.DataFrame':
    """
    Play all policies in all variants of the game.

    :param options: options of one participant, learned in ``domain`` or in a variant of it.
    :param games: number of games per policy, two or more.
    :param game_steps: game steps per plan; 0: the planner's default.
    :param progress: callback after each policy; its exceptions propagate.
    :param jobs: as in ``all_of``.
    :param known: plan with all options in ``domain``, made with the same seed; None: make one.
    :return: one row per policy and variant: columns ``GAMES``, and the scores of the games (E,) as
        ``scores``.
    :raises PlanError: the domain cannot play many games, or the options belong to another game.
    """
    variants = {
        name: make_domain(domain.name, {**domain.parameters, **changed})
        for name, changed in baselines_of(domain).variants.items()
    } or {'': domain}
    steps = game_steps or usual_game_steps(domain)
    baselines = [
        (setting, variant, baseline)
        for setting, variant in variants.items()
        for baseline in every_baseline(variant, options, steps)
    ]
    usual = domain.parameters, PLAN, len(options), PlanRequest(HUMAN, game_steps=steps)
    found = {
        number: play_baseline(variant, baseline, seed, games, known)
        for number, (_, variant, baseline) in enumerate(baselines)
        if known and known[1].episodes == games
        if (variant.parameters, baseline.kind, len(baseline.options), baseline.request) == usual
    }
    left = {number: baseline for number, baseline in enumerate(baselines) if number not in found}
    calls = [
        partial(play_baseline, variant, baseline, seed, games)
        for _, variant, baseline in left.values()
    ]
    names = [
        ': '.join(filter(None, (setting, baseline.name))) for setting, _, baseline in left.values()
    ]
    costs = [PLAYING + baseline.request.game_steps for *_, baseline in left.values()]
    progress(0, len(calls), f'{len(calls)} policies, side by side')
    found |= zip(left, all_of(calls, names, costs, progress, jobs))
    rows = [
        {'setting': setting, **found[number]} for number, (setting, *_) in enumerate(baselines)
    ]
    return table({**COLUMNS, 'scores': 'object'}, rows)
