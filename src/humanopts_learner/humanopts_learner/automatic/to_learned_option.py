"""Automatic options as learned ones: decision trees that agree with their tables."""

from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.search_space import SearchSpace
from humanopts_learner.automatic.extract import AutomaticOption, AutomaticOptions
from humanopts_learner.options.option import LearnedOption, option_from_tables
from humanopts_learner.planning.action_sets import MACHINE
from humanopts_learner.planning.errors import PlanError
from humanopts_learner.qlearning import Ints
import numpy as np
from numpy.typing import NDArray


def to_learned_options(
    domain: Domain[Any], found: AutomaticOptions, participant: str = MACHINE
) -> list[LearnedOption]:
    """
    Return the options so that they can be saved, sent, served and planned with like others.

    Each depends on as few features as its tables need. The trees agree with the tables in every
    state that an episode passes through: I and beta in all of them, and pi in I.

    :param found: automatic options of this domain.
    :param participant: the participant code of the options; begins with ``MACHINE``.
    :raises PlanError: the participant has another code.
    :raises DomainError: two states with equal features have different entries in the tables.
    """
    check_participant(participant)
    return [_learned(domain, option, participant, found.space) for option in found.options]


def check_participant(code: str) -> None:
    """
    Check the participant code of automatic options.

    :raises PlanError: it could be the code of a person.
    """
    if not code.startswith(MACHINE):
        raise PlanError(
            f'the participant of options that nobody taught must begin with {MACHINE!r}, '
            f'not {code!r}'
        )


def _learned(
    domain: Domain[Any],
    option: AutomaticOption,
    participant: str,
    space: SearchSpace,
) -> LearnedOption:
    tables, rows, going = option.tables, space.rows, space.open
    decisions = 2 * np.where(tables.initiation, 1 + tables.action, 0) + tables.termination
    needed = _needed(rows[going], list(space.columns), decisions[going])
    return option_from_tables(
        domain,
        option.name,
        [domain.features[column].name for column in needed],
        rows,
        tables,
        (going & tables.initiation, going, going),
        participant,
        option.max_steps,
    )


def _needed(rows: NDArray[np.int32], columns: list[int], decisions: Ints) -> list[int]:
    """Return the feature indices without those, tried from the last, that are not needed."""
    for column in reversed(columns):
        others = [other for other in columns if other != column]
        if others and _determine(rows[:, others], decisions):
            columns = others
    return columns


def _determine(seen: NDArray[np.int32], decisions: Ints) -> bool:
    """Return whether equal rows always come with equal decisions."""
    both = np.column_stack([seen, decisions])
    return len(np.unique(seen, axis=0)) == len(np.unique(both, axis=0))
