"""The accuracy of the options taught in a study, as in figure 2 of the paper."""

from collections.abc import Collection, Sequence
from functools import cache
import json
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.registry import make_domain, reference_options
from humanopts_learner.demonstrations import Demonstration, Kind, shown
from humanopts_learner.options.accuracy import average_returns
from humanopts_learner.options.learn import learn_option
from humanopts_teach.evaluation.bag_evaluation import usable_demonstrations
from humanopts_teach.evaluation.tables import accuracies
from humanopts_teach.study.tables import StudyData
import pandas as pd

PAPER_DEMONSTRATIONS = 40  # section 7.1, figure 2: trajectories for acceptable accuracy
PAPER_MINUTES = {'taxi': 15.0, 'pacman': 20.0}  # section 7.1: upper limits of the average
COLUMNS = (
    *('domain', 'condition', 'option', 'participant', 'demonstrations'),
    'policy',  # share of states in which the option's action is one of the best
    'classification',  # share of states classified like the reference option, mean of I and beta
    'return',  # mean return from the reference option's I; only after the last demonstration
    'best_return',  # mean return of the reference option from its I
)


def accuracy_table(data: StudyData, participants: Collection[str]) -> pd.DataFrame:
    """
    Return a row for each demonstration of an option that has a reference option.

    Each option of the paper's games is relearned from its first demonstrations.

    :param participants: codes of the participants to include.
    :return: columns ``COLUMNS``.
    """
    make = cache(lambda name, parameters: make_domain(name, json.loads(parameters)))
    rows = list[dict[str, Any]]()
    for record in data.records:
        plan = data.plan_of(record)
        if plan is None or record.code not in participants:
            continue
        for condition in plan.order_of(record.place):
            entries = data.lessons.get((record.code, condition.name), ())
            given = [each for each in entries if isinstance(each, Demonstration)]
            if not given or condition.domain not in PAPER_MINUTES:
                continue
            domain = make(condition.domain, json.dumps(condition.parameters))
            for (code, name), own in usable_demonstrations(given, domain)[0].items():
                if name in reference_options(domain):
                    who = condition.domain, condition.name, name, code
                    curve = _curve(shown(own), domain, plan.seed + record.number)
                    rows += [dict(zip(COLUMNS, who)) | row for row in curve]
    return pd.DataFrame(rows, columns=[*COLUMNS])


def _curve(given: Sequence[Demonstration], domain: Domain, seed: int) -> list[dict[str, Any]]:
    """
    Return the accuracies of an option after each of its trajectories.

    :param given: at least one trajectory, and any "not here" answers.
    """
    rows = list[dict[str, Any]]()
    for count, demo in enumerate(given, start=1):
        if demo.kind is Kind.TRAJECTORY:
            option = learn_option(given[:count], domain, seed)
            policy, starts, ends = accuracies(option, domain).values()
            both = None if starts is None or ends is None else (starts + ends) / 2
            number = len(rows) + 1
            rows.append({'demonstrations': number, 'policy': policy, 'classification': both})
    option = learn_option(given, domain, seed)
    reference = reference_options(domain)[option.name]
    mine, best = average_returns([option, None], domain, reference)
    rows[-1] |= {'return': mine, 'best_return': best}
    return rows
