"""Reference options of a domain as learned ones: a ready set, for planning without a teacher."""

from collections.abc import Iterable, Sequence
from typing import Any

from humanopts_env.domains.base import DomainError, EnumerableDomain
from humanopts_env.domains.reference import ReferenceOption, TabularReferenceOption
from humanopts_env.domains.registry import parameters_json
from humanopts_learner.options.option import LearnedOption, MEMBERSHIP
from humanopts_learner.trees.encoding import encode_rows, encoding
from humanopts_learner.trees.fitting import fit_tree
from humanopts_learner.trees.tree import Tree
import numpy as np
from numpy.typing import NDArray

PARTICIPANT = 'reference'
MAX_STEPS = 200


def ready_options(
    domain: EnumerableDomain[Any],
    references: Iterable[ReferenceOption],
    max_steps: int = MAX_STEPS,
) -> list[LearnedOption]:
    """
    Return options whose trees say in every state what the reference options say.

    Where several actions are optimal, the first is taken. Nothing learned ever comes from here.

    :param references: of this domain, as ``registry.reference_options`` has them by name.
    :raises DomainError: one has no tables, or its features do not tell what it does.
    """
    return [_ready(domain, reference, max_steps) for reference in references]


def _ready(
    domain: EnumerableDomain[Any], reference: ReferenceOption, max_steps: int
) -> LearnedOption:
    if not isinstance(reference, TabularReferenceOption):
        raise DomainError(f'{reference.name!r} of {domain.name} has no tables')
    columns = encoding(domain, reference.features)
    X = encode_rows(columns, domain.feature_table())
    acts, judged = reference.initiation, reference.judged
    open_states = judged & ~domain.over()

    def tree(rows: NDArray[np.bool_], labels: NDArray[np.integer], classes: Sequence[int]) -> Tree:
        fitted = fit_tree(X[rows], labels[rows], classes, 0)
        if (fitted.probabilities(X[rows]).argmax(axis=1) != labels[rows]).any():
            raise DomainError(f'the features of {reference.name!r} do not tell what it does')
        return fitted

    return LearnedOption(
        name=reference.name,
        participant=PARTICIPANT,
        domain=domain.name,
        domain_parameters=parameters_json(domain),
        actions=tuple(action.name for action in domain.actions),
        features=tuple(reference.features),
        columns=columns,
        policy=tree(acts, reference.optimal.argmax(axis=1), range(len(domain.actions))),
        initiation=tree(open_states, reference.initiation.astype(np.intp), MEMBERSHIP),
        termination=tree(judged, reference.termination.astype(np.intp), MEMBERSHIP),
        n_demonstrations=0,
        n_not_here=0,
        max_steps=max_steps,
        uuids=(),
    )
