"""Derived features are learned from, kept, sent, planned with and explained like any other."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from humanopts_env.domains.formulas import feature_columns
from humanopts_env.domains.registry import make_domain, reference_options
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import (
    check_demonstration,
    Demonstration,
    demonstration_from_message,
    DemonstrationError,
    GOAL,
)
from humanopts_learner.options.accuracy import policy_accuracy
from humanopts_learner.options.conflicts import advise
from humanopts_learner.options.decision_tree import encode_rows, feature_encoding
from humanopts_learner.options.files import load_option, save_option
from humanopts_learner.options.judge import judge, Thresholds
from humanopts_learner.options.learn import learn_option, make_dataset
from humanopts_learner.options.learned_option import OptionError
from humanopts_learner.options.rollout import rollouts
from humanopts_learner.options.starts import choose_start_state, STRATEGIES
from humanopts_learner.planning.abstraction import Column
from humanopts_learner.planning.plan import make_plan
from humanopts_learner.planning.request import PlanRequest
from humanopts_learner.ros.convert import demonstration_to_message
from humanopts_teach.lesson.in_process import teach
from humanopts_teach.lesson.seeded_starts import LessonRules
from humanopts_teach.lesson.simulated_teacher import TeacherSettings
from humanopts_teach.report.rules import option_rules
import numpy as np
import pytest

TAXI = make_domain('taxi')
FETCH = 'go to passenger and pickup'
ROWS, COLS = 'taxi_row - passenger_row', 'taxi_col - passenger_col'
AT_R = "passenger_row == '0' and passenger_col == '0'"
DERIVED = ('taxi_row', 'taxi_col', AT_R, COLS, ROWS)  # they determine where the passenger is


@pytest.fixture(scope='module')
def shown() -> Sequence[Demonstration]:
    taught = teach(TAXI, TeacherSettings((FETCH,), seed=1), LessonRules(seed=1, budget=12))
    return [replace(demo, chosen_features=DERIVED) for demo in taught.demonstrations]


def test_they_are_the_columns_that_python_computes() -> None:
    rows = TAXI.feature_table()
    at = {feature.name: rows[:, column] for column, feature in enumerate(TAXI.features)}
    at_r = (at['passenger_row'] == 0) & (at['passenger_col'] == 0)
    expected = [
        at['taxi_row'],
        at['taxi_col'],
        ~at_r,
        at_r,
        at['taxi_col'] - at['passenger_col'],
        at['taxi_row'] - at['passenger_row'],
    ]
    encoding = feature_encoding(TAXI, DERIVED[::-1])
    assert np.array_equal(encode_rows(encoding, rows), np.column_stack(expected))


@pytest.mark.parametrize('method', ['trees', GOAL])
def test_an_option_is_learned_from_them(
    shown: Sequence[Demonstration], method: str, tmp_path: Path
) -> None:
    demos = [replace(demo, method=method) for demo in shown]
    option = learn_option(demos, TAXI, 0)
    assert option.features == tuple(c.feature.name for c in feature_columns(TAXI, DERIVED))
    reference = reference_options(TAXI)[FETCH]
    plain = [replace(demo, chosen_features=reference.features) for demo in demos]
    with_plain = learn_option(plain, TAXI, 0)
    accuracy = policy_accuracy(option, TAXI, reference)
    assert accuracy >= policy_accuracy(with_plain, TAXI, reference) - 0.1
    assert load_option(save_option(tmp_path, option, demos)) == (option, demos)
    option.check_domain(TAXI)
    bigger = make_domain('taxi', {'rows': 7, 'cols': 7})
    with pytest.raises(OptionError, match='was learned in taxi'):
        option.check_domain(bigger)
    rules = '\n'.join(rule.text for rule in option_rules(option, TAXI))
    assert '(taxi_row - passenger_row) ≤' in rules
    assert judge(demos, TAXI, Thresholds(), 0, option).criteria
    advise(make_dataset(demos, TAXI), TAXI)
    for strategy in STRATEGIES:
        rng = generator(1, strategy)
        assert TAXI.encode(choose_start_state(strategy, TAXI, option, demos, rng))


def test_they_survive_the_message_and_are_checked(shown: Sequence[Demonstration]) -> None:
    demo = shown[0]
    assert demonstration_from_message(demonstration_to_message(demo)) == demo
    check_demonstration(demo, TAXI)
    with pytest.raises(DemonstrationError, match="no feature 'taxi_rw'; did you mean taxi_row"):
        check_demonstration(replace(demo, chosen_features=('taxi_rw - 1',)), TAXI)
    with pytest.raises(DemonstrationError, match='must be written as'):
        check_demonstration(replace(demo, chosen_features=('taxi_row-1',)), TAXI)


def test_a_plan_uses_options_and_columns_of_them(shown: Sequence[Demonstration]) -> None:
    option = learn_option(shown, TAXI, 0)
    assert make_plan(TAXI, [option], PlanRequest('human+primitive'))
    rows = TAXI.feature_table()
    offset = rows[:, 0] - rows[:, 2]
    assert np.array_equal(Column(f'{ROWS}:-1,2', TAXI).bins(rows), np.digitize(offset, [-1, 2]))
    assert np.array_equal(Column(f'{ROWS} > 1', TAXI).bins(rows), offset > 1)
    assert len(Column(ROWS, TAXI).edges) == 9


def test_two_of_them_replace_many_demonstrations_of_lunar_lander() -> None:
    """The plain features need dozens of demonstrations."""
    domain = make_domain('gymnasium:LunarLander-v3')
    (reference,) = reference_options(domain).values()
    assert len(reference.features) == 2
    taught = teach(
        domain,
        TeacherSettings((reference.name,), seed=3),
        LessonRules(seed=3, until_no_failures=False),
        lambda demos, option: option.n_demonstrations == 2,
    )
    names = tuple(feature.name for feature in domain.features)
    plain = [replace(demo, chosen_features=names) for demo in taught.demonstrations]
    landed = []
    for option in (*taught.options, learn_option(plain, domain, 0)):
        rng = generator(1, 'land')
        starts = [domain.reset(rng) for _ in range(20)]
        landed.append((rollouts(option, domain, starts).total_reward > 100).mean())  # for landing
    assert landed[0] > 0.7 > 0.4 > landed[1]
