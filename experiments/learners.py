"""
Behavioural cloning by other classifiers, which see the same rows as the tree of a policy.

A tree can be read; these cannot. Beside them the reader sees what that costs: in figure 2 by their
best actions, in table 2 by plans with options whose policies they are.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from humanopts_env.arrays import Ints, Rows
from humanopts_env.domains.base import Domain, EnumerableDomain
from humanopts_env.domains.reference import ReferenceOption
from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.options.accuracy import action_accuracy
from humanopts_learner.options.decision_tree import encode_rows
from humanopts_learner.options.learn import make_dataset
from humanopts_learner.options.option import tabulate
from sklearn import config_context
from sklearn.ensemble import RandomForestClassifier
from sklearn.neighbors import KNeighborsClassifier

from experiments.people import CLOCK, OwnedOptions

NEIGHBOURS, TREES = 3, 100
NEIGHBOUR, FOREST = f'{NEIGHBOURS} nearest neighbours', f'random forest, {TREES} trees'
LEARNERS: dict[str, Callable[[int, int], Any]] = {  # of the number of rows, and a seed
    NEIGHBOUR: lambda count, seed: KNeighborsClassifier(min(NEIGHBOURS, count)),
    FOREST: lambda count, seed: RandomForestClassifier(TREES, random_state=seed),
}


def cloned_policy(
    learner: str, demonstrations: Sequence[Demonstration], domain: Domain[Any], seed: int
) -> Callable[[Rows], Ints]:
    """
    Return a policy that was learned by one of ``LEARNERS``: of rows (N, F) the actions (N,).

    :param demonstrations: of one option, a trajectory among them.
    """
    data = make_dataset(demonstrations, domain)
    seen, actions = encode_rows(data.encoding, data.policy.rows), data.policy.labels
    model = LEARNERS[learner](len(actions), seed).fit(seen, actions)
    return lambda rows: model.predict(encode_rows(data.encoding, rows))


def cloned_accuracies(
    demonstrations: Sequence[Demonstration],
    domain: Domain[Any],
    reference: ReferenceOption,
    seed: int,
) -> dict[str, float]:
    """
    Return the policy accuracy of each other classifier, as ``policy_accuracy`` has it of the tree.

    :param demonstrations: of one option, a trajectory among them.
    :return: 0..1 by name; NaN where the reference can start nowhere.
    """
    with config_context(assume_finite=True, skip_parameter_validation=True):  # quicker
        policies = {name: cloned_policy(name, demonstrations, domain, seed) for name in LEARNERS}
        return {
            name: action_accuracy(policy, domain, reference) for name, policy in policies.items()
        }


def with_cloned_policies(
    learner: str, owned: OwnedOptions, domain: EnumerableDomain[Any], seed: int
) -> OwnedOptions:
    """
    Return what a person taught with policies that were learned by one of ``LEARNERS``.

    Initiation sets and terminations stay those of the trees.

    :return: options as tables; the seconds are those of learning and of evaluating in all states.
    """
    began, rows, options = CLOCK(), domain.feature_table(), []
    for option in owned.options:
        shown = [demo for demo in owned.shown if demo.option_name == option.name]
        policy = cloned_policy(learner, shown, domain, seed)
        options.append(replace(tabulate(option, domain), action=policy(rows)))
    return replace(owned, options=tuple(options), seconds=CLOCK() - began)
