"""Options with known tables as learned ones; and those of reference, a set without a teacher."""

from collections.abc import Iterable, Sequence
from typing import Any

from humanopts_env.domains.base import Domain, DomainError, EnumerableDomain
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
Said = tuple[NDArray[np.bool_], NDArray[Any]]  # (S,) of which states, and what is said of all


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
    return exact_option(
        domain,
        reference.name,
        PARTICIPANT,
        reference.features,
        domain.feature_table(),
        (reference.initiation, reference.optimal.argmax(axis=1)),
        (reference.judged & ~domain.over(), reference.initiation),
        (reference.judged, reference.termination),
        max_steps,
    )


def exact_option(
    domain: Domain[Any],
    name: str,
    participant: str,
    features: Sequence[str],
    rows: NDArray[np.int32],
    policy: Said,
    initiation: Said,
    termination: Said,
    max_steps: int,
) -> LearnedOption:
    """
    Return the option whose trees say what is known already, of the states that it is known of.

    :param features: those that the trees look at.
    :param rows: (S, F) all features of S states.
    :raises DomainError: the features do not tell what it does.
    """
    columns = encoding(domain, features)
    X = encode_rows(columns, rows)

    def tree(said: Said, classes: Sequence[int]) -> Tree:
        seen, labels = X[said[0]], said[1][said[0]].astype(np.intp)
        fitted = fit_tree(seen, labels, classes, 0)
        if (fitted.likeliest(seen) != labels).any():
            raise DomainError(f'the features of {domain.name} do not tell what {name!r} does')
        return fitted

    return LearnedOption(
        name=name,
        participant=participant,
        domain=domain.name,
        domain_parameters=parameters_json(domain),
        actions=tuple(action.name for action in domain.actions),
        features=tuple(features),
        columns=columns,
        policy=tree(policy, range(len(domain.actions))),
        initiation=tree(initiation, MEMBERSHIP),
        termination=tree(termination, MEMBERSHIP),
        n_demonstrations=0,
        n_not_here=0,
        max_steps=max_steps,
        uuids=(),
    )
