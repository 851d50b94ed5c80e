"""The options that were learned from a bag, in many games."""

from dataclasses import replace
from typing import Any

from humanopts_env.domains.base import Domain, is_enumerable
from humanopts_learner.planning.errors import PlanError
from humanopts_learner.planning.sampled.state_abstraction import batch_games
from humanopts_teach.evaluation.bag_evaluation import BagEvaluation, EvaluationError
from humanopts_teach.evaluation.comparison import Report
from humanopts_teach.evaluation.games import evaluate_games, GAMES


def check_games(domain: Domain[Any]) -> None:
    """
    Check that plans can be compared in many games.

    :raises EvaluationError: plans of the domain are exact, or it cannot play many games.
    """
    if is_enumerable(domain):
        raise EvaluationError(f'plans in {domain.name} are exact: there is nothing to estimate')
    try:
        batch_games(domain)
    except PlanError as error:
        raise EvaluationError(f'the games cannot be played: {error}') from error


def with_games(
    evaluation: BagEvaluation, games: int = GAMES, progress: Report | None = None
) -> BagEvaluation:
    """
    Have each participant's options play many games, beside what they are compared with.

    :param games: that everything is judged by, two or more.
    :param progress: told what is under way and the share that is done.
    :raises EvaluationError: plans of the domain are exact, or it cannot play many games.
    """
    domain = evaluation.domain
    check_games(domain)
    people = list(dict.fromkeys(option.participant for option in evaluation.options))
    found = {}
    for number, person in enumerate(people):
        options = [o.option for o in evaluation.options if o.participant == person]

        def tell(what: str, share: float, before: int = number) -> None:
            if progress is not None:
                progress(what, (before + share) / len(people))

        try:
            found[person] = evaluate_games(
                domain, options, evaluation.settings.seed, games, progress=tell
            )
        except PlanError as error:
            raise EvaluationError(f'the games cannot be played: {error}') from error
    return replace(evaluation, games=found)
