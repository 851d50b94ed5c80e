"""Times to learn an option again after a demonstration, as the learner node does."""

from collections.abc import Callable, Sequence
from functools import partial

from humanopts_env.domains.taxi import Taxi
from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.options.criteria import judge, Thresholds
from humanopts_learner.options.decision_tree import encode_rows
from humanopts_learner.options.learn import learn_option, make_dataset
from humanopts_teach.lesson.in_process import teach
from humanopts_teach.lesson.seeded_starts import LessonRules
from humanopts_teach.lesson.simulated_teacher import TeacherSettings

from benchmarks.measure import compare, in_turns, OnMeasured, Row, timed
from benchmarks.planning import OPTIONS

COUNTS = (10, 20, 40)
QUICK = ((10,), 2)
YARDSTICK = 'one scikit-learn tree of the rows of the policy'
SEED = 1
ASKED = 6  # most start states for each demonstration, "not here" answers included


def measure(progress: OnMeasured, counts: Sequence[int] = COUNTS, repeats: int = 20) -> list[Row]:
    """
    Learn an option of Taxi after some demonstrations, and judge it by the three criteria.

    :param counts: demonstrations, as many as each row is of.
    :param repeats: turns of each work.
    """
    domain, rows = Taxi(), []
    shown = demonstrations(domain, OPTIONS[0], max(counts))
    for number, count in enumerate(counts):
        progress(number / len(counts), f'learning after {count} demonstrations')
        rows += _rows(shown[:count], domain, repeats)
    return rows


def demonstrations(domain: Taxi, option: str, count: int) -> list[Demonstration]:
    """Have a simulated teacher show an option from random start states, without errors."""
    rules = LessonRules('random', ASKED * count, SEED)
    taught = teach(
        domain,
        TeacherSettings((option,), seed=SEED),
        rules,
        lambda shown, learned: learned.n_demonstrations >= count,
    )
    return [demo for demo in taught.demonstrations if demo.actions]


def _rows(shown: Sequence[Demonstration], domain: Taxi, repeats: int) -> list[Row]:
    from sklearn.tree import DecisionTreeClassifier

    data = make_dataset(shown, domain)
    X, y = encode_rows(data.encoding, data.policy.rows), data.policy.labels
    option = learn_option(shown, domain, SEED)
    works: dict[str, Callable[[], object]] = {
        'three trees fitted': partial(learn_option, shown, domain, SEED),
        'the criteria judged': partial(judge, shown, domain, Thresholds(), SEED, option),
        YARDSTICK: lambda: DecisionTreeClassifier(random_state=SEED).fit(X, y),
    }
    *ours, yardstick = in_turns([partial(timed, work) for work in works.values()], repeats)
    after = f'after {len(shown)} demonstrations'
    facts = {'demonstrations': len(shown), 'rows': len(X)}
    return [
        compare(f'{after}: {what}', own, YARDSTICK, yardstick, facts=facts)
        for what, own in zip(works, ours)
    ]
