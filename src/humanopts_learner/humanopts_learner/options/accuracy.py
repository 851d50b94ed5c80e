"""How close a learned option is to what an expert means by it (paper, section 7.1, figure 2)."""

from typing import Any

from humanopts_env.domains.base import EnumerableDomain
from humanopts_env.domains.reference import TabularReferenceOption
from humanopts_learner.options.option import LearnedOption, option_tables
import numpy as np


def policy_accuracy(
    option: LearnedOption, domain: EnumerableDomain[Any], reference: TabularReferenceOption
) -> float:
    """
    Return the share of open states of the reference's initiation set that are acted in optimally.

    :return: 0..1; NaN where the reference can start nowhere.
    :raises OptionError: the option was not learned in this domain.
    """
    states = np.flatnonzero(reference.initiation & ~domain.over())
    if not states.size:
        return float('nan')
    action = option_tables(option, domain).action
    return float(reference.optimal[states, action[states]].mean())


def classification_accuracy(
    option: LearnedOption, domain: EnumerableDomain[Any], reference: TabularReferenceOption
) -> tuple[float, float]:
    """
    Return the shares of judged states that I and beta classify as the reference does.

    Whether an option can start is asked only while the task is not over.

    :raises OptionError: the option was not learned in this domain.
    """
    tables, judged = option_tables(option, domain), reference.judged
    same_initiation = tables.initiation == reference.initiation
    same_termination = tables.termination == reference.termination
    return (
        float(same_initiation[judged & ~domain.over()].mean()),
        float(same_termination[judged].mean()),
    )
