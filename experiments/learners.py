"""
Behavioural cloning by other classifiers, which see the same rows as the tree of a policy.

A tree can be read; these cannot. Beside them the reader sees what that costs.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any

from humanopts_env.arrays import Ints, Rows
from humanopts_env.domains.base import Domain
from humanopts_env.domains.reference import ReferenceOption
from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.options.accuracy import action_accuracy
from humanopts_learner.options.decision_tree import encode_rows
from humanopts_learner.options.learn import make_dataset
from sklearn.ensemble import RandomForestClassifier
from sklearn.neighbors import KNeighborsClassifier

NEIGHBOURS, TREES = 3, 100
NEIGHBOUR, FOREST = f'{NEIGHBOURS} nearest neighbours', f'random forest, {TREES} trees'


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
    data = make_dataset(demonstrations, domain)
    seen, actions = encode_rows(data.encoding, data.policy.rows), data.policy.labels
    models: dict[str, Any] = {
        NEIGHBOUR: KNeighborsClassifier(min(NEIGHBOURS, len(actions))),
        FOREST: RandomForestClassifier(TREES, random_state=seed),
    }
    for model in models.values():
        model.fit(seen, actions)

    def choose(model: Any, rows: Rows) -> Ints:
        chosen: Ints = model.predict(encode_rows(data.encoding, rows))
        return chosen

    return {
        name: action_accuracy(partial(choose, model), domain, reference)
        for name, model in models.items()
    }
