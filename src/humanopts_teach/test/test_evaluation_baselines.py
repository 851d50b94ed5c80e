"""Ways to play Pac-Man, compared under the same rules."""

from humanopts_env.domains.pacman.baselines import play_heuristic
from humanopts_env.domains.pacman.domain import PacMan
from humanopts_env.domains.registry import parameters_json
from humanopts_env.domains.rooms import Rooms
from humanopts_env.domains.rooms_reference import reference_options as rooms_references
from humanopts_learner.demonstrations import Demonstration, group_by_option
from humanopts_learner.options.learn import learn_option
from humanopts_learner.options.option import LearnedOption, options_from_references
from humanopts_learner.planning.request import (
    HUMAN,
    PlanError,
    PlanRequest,
    PRIMITIVE,
)
from humanopts_learner.planning.sampled.plan import make_sampled_plan
from humanopts_teach.evaluation.games import (
    Baseline,
    baselines_of,
    carried_over,
    ComparisonRow,
    HEURISTIC,
    PLAN,
    planning_curve,
    play_baseline,
    RANDOM,
)
import pytest

pytestmark = pytest.mark.heavy

GAMES, STEPS, SEED = 40, 3_000, 3


@pytest.fixture(scope='module')
def domain(yard: PacMan) -> PacMan:
    """A small maze."""
    return yard


@pytest.fixture(scope='module')
def options(domain: PacMan, yard_lesson: list[Demonstration]) -> list[LearnedOption]:
    """Ways to food, from ghosts, to pills and to scared ghosts."""
    groups = group_by_option(yard_lesson).values()
    return [learn_option(demonstrations, domain, SEED) for demonstrations in groups]


@pytest.fixture(scope='module')
def baselines(options: list[LearnedOption]) -> list[Baseline]:
    """One of each kind, and primitive actions."""
    return [
        Baseline('planned', PLAN, HUMAN, options, STEPS),
        Baseline('moves', RANDOM, PRIMITIVE),
        Baseline('any option', RANDOM, HUMAN, options),
        Baseline('rule', HEURISTIC),
        Baseline('rule, each step', HEURISTIC, to_end=False),
    ]


@pytest.fixture(scope='module')
def rows(domain: PacMan, baselines: list[Baseline]) -> list[ComparisonRow]:
    """The comparison."""
    return [play_baseline(domain, baseline, SEED, GAMES) for baseline in baselines]


def test_every_baseline_has_its_row_in_order(rows: list[ComparisonRow]) -> None:
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
    domain: PacMan, options: list[LearnedOption], rows: list[ComparisonRow]
) -> None:
    request = PlanRequest(HUMAN, game_steps=STEPS, seed=SEED)
    returns = make_sampled_plan(domain, options, request).play(SEED, GAMES)
    assert rows[0].score.mean == returns.total.mean()
    assert rows[0].fallbacks == returns.fallbacks.mean()


def test_a_curve_has_the_same_score_for_the_same_budget(
    domain: PacMan, options: list[LearnedOption], rows: list[ComparisonRow]
) -> None:
    plan = Baseline('planned', PLAN, HUMAN, options)
    curve = planning_curve(domain, plan, (STEPS // 2, STEPS), SEED, GAMES)
    assert [row.budget_steps for row in curve.rows] == [STEPS // 2, STEPS]
    assert curve.rows[-1].score == rows[0].score


def test_a_curve_ends_where_the_target_is_reached_and_shows_where_it_is_not(
    domain: PacMan, options: list[LearnedOption]
) -> None:
    plan, budgets = Baseline('planned', PLAN, HUMAN, options), (500, 1_000)
    curve = planning_curve(domain, plan, budgets, SEED, 4, target=1e9)  # there are not so many
    assert [row.budget_steps for row in curve.rows] == [500, 1_000]
    assert curve.seconds_to_reach(1e9) is None
    curve = planning_curve(domain, plan, budgets, SEED, 4, target=-1e9)
    assert [row.budget_steps for row in curve.rows] == [500]
    assert curve.seconds_to_reach(-1e9) == curve.rows[0].seconds > 0.0
    curve = planning_curve(domain, plan, budgets, SEED, 4, enough_seconds=1e-9)
    assert len(curve.rows) == 1


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


def test_only_a_domain_with_a_rule_plays_by_it(domain: PacMan) -> None:
    assert baselines_of(domain).heuristic is not None
    assert baselines_of(Rooms()).heuristic is None
    with pytest.raises(PlanError, match='rooms has no rule'):
        play_baseline(Rooms(), Baseline('rule', HEURISTIC), 1)


def test_options_go_along_to_other_parameters_but_not_to_other_features() -> None:
    option = options_from_references(Rooms(), rooms_references(Rooms()).values())[0]
    other = Rooms(goal='G2')
    assert option.domain_parameters != parameters_json(other)
    carried_over(option, other).check_domain(other)
    with pytest.raises(PlanError):
        carried_over(option, PacMan())
