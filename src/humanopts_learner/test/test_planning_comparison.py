"""Ways to play Pac-Man, compared under the same rules."""

from dataclasses import dataclass, replace
from typing import Any

from humanopts_env.domains.pacman.baselines import play_heuristic
from humanopts_env.domains.pacman.domain import PacMan
from humanopts_env.domains.pacman.features import look_around
from humanopts_env.domains.pacman.reference import PacManOption, reference_options
from humanopts_env.domains.registry import parameters_json
from humanopts_env.domains.rooms import Rooms
from humanopts_env.domains.rooms_reference import reference_options as rooms_references
from humanopts_env.seeding import generator
from humanopts_learner.options.option import options_from_references
from humanopts_learner.planning.action_sets import HUMAN, PRIMITIVE
from humanopts_learner.planning.errors import ForeignOptionError, PlanCanceled, PlanError
from humanopts_learner.planning.sampled.comparison import (
    Baseline,
    baselines_of,
    carried_over,
    CHANCE,
    compare,
    ComparisonRow,
    PLAN,
    RULE,
    share_interval,
)
from humanopts_learner.planning.sampled.curve import Budgets, planning_curve
from humanopts_learner.planning.sampled.plan import make_sampled_plan
import numpy as np
import pytest

GAMES, STEPS, SEED = 40, 8_000, 3


@dataclass(frozen=True)
class Scripted:
    """A reference option as a batch option."""

    option: PacManOption
    max_steps: int = 200

    @property
    def name(self) -> str:
        """Name of the option."""
        return self.option.name

    def can_start(self, view: Any) -> Any:
        """Return where it can start."""
        return self.option.judge(view.batch, look_around(view.batch)).initiation

    def ends(self, view: Any) -> Any:
        """Return where it ends."""
        return self.option.judge(view.batch, look_around(view.batch)).termination

    def action(self, view: Any) -> Any:
        """Return the first of the best actions."""
        return self.option.judge(view.batch, look_around(view.batch)).optimal.argmax(axis=1)


@pytest.fixture(scope='module')
def domain() -> PacMan:
    """A small maze."""
    return PacMan('yard', max_steps=150)


@pytest.fixture(scope='module')
def options(domain: PacMan) -> list[Scripted]:
    """The four reference options."""
    return [Scripted(option) for option in reference_options(domain).values()]


@pytest.fixture(scope='module')
def contenders(options: list[Scripted]) -> list[Baseline]:
    """One of each kind, and primitive actions."""
    return [
        Baseline('planned', PLAN, HUMAN, options, STEPS),
        Baseline('moves', CHANCE, PRIMITIVE),
        Baseline('any option', CHANCE, HUMAN, options),
        Baseline('rule', RULE),
        Baseline('rule, each step', RULE, to_end=False),
    ]


@pytest.fixture(scope='module')
def rows(domain: PacMan, contenders: list[Baseline]) -> list[ComparisonRow]:
    """The comparison."""
    return compare(domain, contenders, SEED, GAMES)


def test_every_contender_has_its_row_in_order(rows: list[ComparisonRow]) -> None:
    assert [row.name for row in rows] == [
        'planned',
        'moves',
        'any option',
        'rule',
        'rule, each step',
    ]
    assert {row.games for row in rows} == {GAMES}
    for row in rows:
        assert set(row.outcomes) == {'cleared', 'lives left'}
        for interval in (row.score, *row.outcomes.values()):
            assert interval.low <= interval.mean <= interval.high
        assert (row.seconds is None, row.game_steps > 0) == (row.kind != PLAN, row.kind == PLAN)
    assert rows[0].game_steps <= STEPS


def test_a_plan_is_judged_as_when_it_is_made_alone(
    domain: PacMan, options: list[Scripted], rows: list[ComparisonRow]
) -> None:
    returns = make_sampled_plan(domain, HUMAN, options, STEPS, SEED).play(SEED, GAMES)
    assert rows[0].score.mean == returns.total.mean()
    assert rows[0].fallbacks == returns.fallbacks.mean()


def test_a_curve_has_the_same_score_for_the_same_budget(
    domain: PacMan, options: list[Scripted], rows: list[ComparisonRow]
) -> None:
    budgets = Budgets(STEPS // 2, STEPS)
    curve = planning_curve(domain, HUMAN, options, 1e9, SEED, budgets, GAMES)
    assert [row.budget_steps for row in curve] == [STEPS // 2, STEPS]
    assert curve[-1].score == rows[0].score


def test_a_curve_ends_when_planning_took_long_enough(
    domain: PacMan, options: list[Scripted]
) -> None:
    curve = planning_curve(
        domain, HUMAN, options, 1e9, SEED, Budgets(STEPS, 8 * STEPS), GAMES, enough_seconds=1e-9
    )
    assert [row.budget_steps for row in curve] == [STEPS]


def test_a_rule_is_that_of_the_baselines(domain: PacMan, rows: list[ComparisonRow]) -> None:
    scores = play_heuristic(domain, GAMES, SEED, to_end=True)
    assert rows[3].score.mean == scores.total.mean()
    assert rows[3].outcomes['cleared'].mean == scores.outcomes['cleared'].mean()
    assert rows[3].score != rows[4].score


def test_options_play_better_than_random_moves(rows: list[ComparisonRow]) -> None:
    moves = rows[1]
    assert all(row.score.low > moves.score.high for row in rows if row is not moves)
    assert moves.decisions is not None
    assert moves.fallbacks == 0.0


def test_the_same_seed_gives_the_same_rows(
    domain: PacMan, contenders: list[Baseline], rows: list[ComparisonRow]
) -> None:
    again = compare(domain, contenders, SEED, GAMES, clock=lambda: 0.0)
    assert again == [replace(row, seconds=None if row.seconds is None else 0.0) for row in rows]


def test_progress_rises_over_all_and_can_cancel(
    domain: PacMan, contenders: list[Baseline]
) -> None:
    told: list[tuple[str, float]] = []
    compare(domain, contenders[:2], 1, 2, progress=lambda name, share: told.append((name, share)))
    shares = [share for _, share in told]
    assert shares == sorted(shares)
    assert {name for name, _ in told} == {'planned', 'moves'}
    assert 0.0 <= shares[0] <= shares[-1] <= 1.0

    def stop(name: str, share: float) -> None:
        raise PlanCanceled

    with pytest.raises(PlanCanceled):
        compare(domain, contenders, 1, 2, progress=stop)


def test_only_a_domain_with_a_rule_plays_by_it(domain: PacMan) -> None:
    assert baselines_of(domain).heuristic is not None
    assert baselines_of(Rooms()).heuristic is None
    with pytest.raises(PlanError, match='rooms has no rule'):
        compare(Rooms(), [Baseline('rule', RULE)], 1)


def test_options_go_along_to_other_parameters_but_not_to_other_features() -> None:
    option = options_from_references(Rooms(), rooms_references(Rooms()).values())[0]
    other = Rooms(goal='G2')
    assert option.domain_parameters != parameters_json(other)
    carried_over(option, other).check_domain(other)
    with pytest.raises(ForeignOptionError):
        carried_over(option, PacMan())


@pytest.mark.parametrize(('good', 'low', 'high'), [(0, 0.0, 0.278), (5, 0.237, 0.763)])
def test_shares_have_wilsons_interval(good: int, low: float, high: float) -> None:
    """Of ten; the values are those of Newcombe (1998)."""
    found = share_interval(np.arange(10) < good)
    assert (found.mean, found.low, found.high) == pytest.approx((good / 10, low, high), abs=5e-4)


def test_wilsons_interval_covers_shares_near_one() -> None:
    rng = generator(1, 'shares')
    found = [share_interval(rng.random(100) < 0.98) for _ in range(1000)]
    assert sum(i.low <= 0.98 <= i.high for i in found) >= 930
    assert max(i.high for i in found) <= 1.0
