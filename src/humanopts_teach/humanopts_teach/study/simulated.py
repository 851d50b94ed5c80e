"""The answers of simulated participants to the questions of a study."""

import math
from typing import Any

from humanopts_teach.study.questions import Question, QuestionKind
import numpy as np

_SPAN = 100  # between the limits of a number, where one of them is missing
_TEXT = 'simulated'


def simulated_answer(question: Question, points: int, rng: np.random.Generator) -> Any:
    """
    Return a uniformly drawn answer, as ``Question.accepts``; attention checks are passed.

    :param points: of the rating scale.
    """
    if question.expect is not None:
        return question.expect
    match question.kind:
        case QuestionKind.RATING:
            return int(rng.integers(1, points + 1))
        case QuestionKind.CHOICE:
            return int(rng.integers(1, len(question.options) + 1))
        case QuestionKind.CHOICES:
            chosen = rng.integers(1, len(question.options) + 1, size=len(question.options))
            return tuple(sorted(set(chosen.tolist())))
        case QuestionKind.NUMBER:
            least, most = question.least, question.most
            if least is None:
                least = 0 if most is None else most - _SPAN
            most = least + _SPAN if most is None else most
            low, high = math.ceil(least), math.floor(most)
            return int(rng.integers(low, high + 1)) if low <= high else least
    return _TEXT[: question.max_characters]
