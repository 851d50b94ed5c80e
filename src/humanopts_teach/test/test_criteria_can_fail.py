"""A careless teacher does not meet all criteria, and a careful one needs no more than before."""

from collections.abc import Sequence
from typing import Any
import warnings

from graph_support.scripted import show
from humanopts_env.domains.registry import make_domain
from humanopts_env.domains.tabular import best_paths
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.options.judge import judge, Thresholds
from humanopts_learner.options.learn import learn_option
from humanopts_learner.summary import AGREEMENT
from humanopts_teach.evaluation.bag_evaluation import OptionEvaluation
from humanopts_teach.evaluation.tables import option_row, OPTIONS, table
from humanopts_teach.lesson.in_process import teach
from humanopts_teach.lesson.seeded_starts import LessonRules
from humanopts_teach.lesson.simulated_teacher import TeacherSettings
from humanopts_teach.report.charts import learning_curves
import numpy as np
import pytest

CARELESS = 0.6  # of steps are wrong
LAKE = 'gymnasium:FrozenLake-v1'
FOOD = 'go to the closest food'
FETCH, SOUTH = 'go to passenger and pickup', 'south-west room to south doorway'


def shown(
    domain: str, option: str, error_rate: float, seed: int, budget: int = 40
) -> tuple[Demonstration, ...]:
    """Return what a simulated teacher shows until the lesson ends."""
    teacher = TeacherSettings((option,), error_rate=error_rate, seed=seed)
    rules = LessonRules(seed=seed, budget=budget)
    return teach(make_domain(domain), teacher, rules).demonstrations


def crossings(error_rate: float, seed: int, count: int = 25) -> list[Demonstration]:
    """Return demonstrations of crossing the frozen lake; who falls in tries again."""
    lake = make_domain(LAKE, {'is_slippery': True})
    table, over, rng = lake.transitions(), lake.over(), generator(seed, 'lake')
    _, best = best_paths(table, table.reward > 0, ~over, 0.99)
    dry = np.flatnonzero(~over & best.any(axis=1))

    def choose(taken: int, state: Any) -> str | None:
        good = best[lake.index(state)]
        wrong = rng.random() < error_rate and not good.all()
        return lake.actions[int(rng.choice(np.flatnonzero(good != wrong)))].name

    found: list[Demonstration] = []
    while len(found) < count:
        start = lake.state_at(int(rng.choice(dry)))
        demo = show(
            lake, start, choose, rng, option_name='cross', chosen_features=('row', 'col'),
            number=len(found) + 1,
        )  # fmt: skip
        found += [demo] * (demo.total_reward > 0)
    return found


def met(domain: str, demonstrations: Sequence[Demonstration], seed: int) -> bool:
    return judge(demonstrations, make_domain(domain), Thresholds(), seed).criteria_met


@pytest.mark.heavy
def test_a_lesson_of_a_careless_teacher_does_not_end_with_all_criteria_met() -> None:
    """In Rooms, 40 careless demonstrations teach an option that is right."""
    assert not met('taxi', shown('taxi', FETCH, CARELESS, 1), 1)


def test_crossing_the_frozen_lake_carelessly_does_not_meet_all_criteria() -> None:
    """A threshold of two reward units would be more than the lake can pay."""
    assert not any(met(LAKE, crossings(CARELESS, seed), seed) for seed in range(6))
    success = judge(crossings(0.0, 1, 3), make_domain(LAKE), Thresholds(), 1).criteria[0]
    assert success.threshold == pytest.approx(0.95)


def test_ends_that_chance_leads_to_do_not_hide_that_most_steps_were_wrong() -> None:
    pacman = make_domain('pacman')

    def agrees(error_rate: float) -> bool:
        few = shown('pacman', FOOD, error_rate, 1, budget=12)
        criteria = judge(few, pacman, Thresholds(), 1).criteria
        return {criterion.name: criterion.met for criterion in criteria}[AGREEMENT]

    assert agrees(0.0)
    assert not agrees(CARELESS)


@pytest.mark.parametrize(('domain', 'option', 'most'), [('taxi', FETCH, 21), ('rooms', SOUTH, 12)])
def test_a_careful_teacher_meets_them_with_about_twenty_demonstrations(
    domain: str, option: str, most: int
) -> None:
    demonstrations = shown(domain, option, 0.02, 1)
    assert met(domain, demonstrations, 1)
    assert sum(bool(demo.actions) for demo in demonstrations) <= most


def test_the_return_is_not_measurable_where_random_actions_earn_as_much() -> None:
    """The lesson ends, but does not say that all criteria hold."""
    demonstrations = shown('rooms', SOUTH, 0.0, 1)
    rooms = make_domain('rooms')
    option = learn_option(demonstrations, rooms, 1)
    judgement = judge(demonstrations, rooms, Thresholds(), 1, option)
    success, found, initiation, termination = judgement.criteria
    assert (found.value, found.met) == (None, False)
    assert found.verdict == 'not measurable'
    assert all(criterion.met for criterion in (success, initiation, termination))
    assert judgement.criteria_met
    assert 'cannot be measured' in judgement.result
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        learning = table(OPTIONS, [option_row(judgement, option, rooms)])
        (_, figure, *_) = learning_curves(OptionEvaluation(option, judgement, learning), 'option')
    assert 'not measurable' in figure
