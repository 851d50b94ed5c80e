"""Times to learn an option again after a demonstration, as the learner node does."""

from collections.abc import Sequence
from functools import partial
from typing import Any

from humanopts_env.domains.reference import TabularReferenceOption
from humanopts_env.domains.taxi import Taxi
from humanopts_env.domains.taxi_reference import reference_options
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import Demonstration, make_demonstration
from humanopts_learner.options.criteria import judge, Thresholds
from humanopts_learner.options.decision_tree import encode_rows
from humanopts_learner.options.learn import learn_option, make_dataset
import numpy as np

from benchmarks.measure import clocks, compare, in_turns, OnMeasured, Row, since, Timed
from benchmarks.planning import OPTIONS

COUNTS = (10, 20, 40)
QUICK = ((10,), 2)
YARDSTICK = 'one scikit-learn tree of the rows of the policy'
SEED = 1


def measure(progress: OnMeasured, counts: Sequence[int] = COUNTS, repeats: int = 20) -> list[Row]:
    """
    Learn an option of Taxi after some demonstrations, and judge it by the three criteria.

    :param counts: demonstrations, as many as each row is of.
    :param repeats: turns of each work.
    """
    domain, rows = Taxi(), []
    shown = demonstrations(domain, reference_options(domain)[OPTIONS[0]], max(counts))
    for number, count in enumerate(counts):
        progress(number / len(counts), f'learning after {count} demonstrations')
        rows += _rows(shown[:count], domain, repeats)
    return rows


def demonstrations(
    domain: Taxi, reference: TabularReferenceOption, count: int
) -> list[Demonstration]:
    """Show a reference option from start states that are drawn, without errors."""
    rng = generator(SEED, 'benchmark', 'starts', reference.name)
    starts = rng.choice(np.flatnonzero(reference.initiation), count)
    return [_show(domain, reference, int(start), n) for n, start in enumerate(starts, start=1)]


def _show(
    domain: Taxi, reference: TabularReferenceOption, start: int, number: int
) -> Demonstration:
    rng = generator(SEED, 'benchmark', 'demonstration', number)
    states, over = [domain.state_at(start)], False
    actions: list[str] = []
    rewards: list[float] = []
    while not actions or not (over or reference.ends(states[-1])):
        action = reference.optimal_actions(states[-1])[0]
        outcome = domain.step(states[-1], action, rng)
        states.append(outcome.state)
        actions.append(domain.actions[action].name)
        rewards.append(outcome.reward)
        over = outcome.terminated
    return make_demonstration(
        domain,
        reference.name,
        states,
        actions,
        rewards,
        features=reference.features,
        participant='benchmark',
        session='benchmark',
        number=number,
    )


def _rows(shown: Sequence[Demonstration], domain: Taxi, repeats: int) -> list[Row]:
    from sklearn.tree import DecisionTreeClassifier

    data = make_dataset(shown, domain)
    X, y = encode_rows(data.encoding, data.policy.rows), data.policy.labels
    option = learn_option(shown, domain, SEED)
    works = {
        'three trees fitted': partial(learn_option, shown, domain, SEED),
        'the criteria judged': partial(judge, shown, domain, Thresholds(), SEED, option),
        YARDSTICK: lambda: DecisionTreeClassifier(random_state=SEED).fit(X, y),
    }
    *ours, yardstick = in_turns([partial(_timed, work) for work in works.values()], repeats)
    facts = {'demonstrations': len(shown), 'rows': len(X)}
    return [
        compare(
            f'after {len(shown)} demonstrations: {what}', own, YARDSTICK, yardstick, facts=facts
        )
        for what, own in zip(works, ours)
    ]


def _timed(work: Any) -> Timed:
    began = clocks()
    work()
    return since(began)
