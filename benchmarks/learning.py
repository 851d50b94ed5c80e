"""Times to relearn an option after a demonstration, as in the learner node."""

from functools import cache, partial
from typing import Any

from humanopts_env.domains.taxi import Taxi
from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.options.decision_tree import encode_rows
from humanopts_learner.options.judge import judge, Thresholds
from humanopts_learner.options.learn import learn_option, make_dataset
from humanopts_teach.lesson.in_process import teach
from humanopts_teach.lesson.seeded_starts import LessonRules
from humanopts_teach.lesson.simulated_teacher import TeacherSettings
import pytest
from sklearn.tree import DecisionTreeClassifier

COUNTS, SEED = (10, 20, 40), 1


@cache
def demonstrations(domain: Taxi) -> list[Demonstration]:
    """Have a simulated teacher demonstrate an option from random start states, without errors."""
    teacher = TeacherSettings(('go to passenger and pickup',), seed=SEED)
    rules = LessonRules('random', 6 * max(COUNTS), SEED)  # some answers are "not here"
    taught = teach(domain, teacher, rules, lambda _, o: bool(o.n_demonstrations >= max(COUNTS)))
    return [demo for demo in taught.demonstrations if demo.actions]


DOMAIN = Taxi()


@pytest.mark.parametrize('count', COUNTS)
@pytest.mark.parametrize(
    'what', ['three trees fitted', 'criteria judged', "one scikit-learn tree of the policy's rows"]
)
def bench_learning(benchmark: Any, count: int, what: str) -> None:
    """Learn and evaluate an option after some demonstrations."""
    benchmark.group, benchmark.name = f'learning after {count} demonstrations', what
    shown = demonstrations(DOMAIN)[:count]
    if what == 'three trees fitted':
        benchmark(learn_option, shown, DOMAIN, SEED)
    elif what == 'criteria judged':
        option = learn_option(shown, DOMAIN, SEED)
        benchmark(judge, shown, DOMAIN, Thresholds(), SEED, option)
    else:
        data = make_dataset(shown, DOMAIN)
        X, y = encode_rows(data.encoding, data.policy.rows), data.policy.labels
        benchmark(partial(DecisionTreeClassifier(random_state=SEED).fit, X, y))
