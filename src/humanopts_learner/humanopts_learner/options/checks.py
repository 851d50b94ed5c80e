"""TEMPORARY: replaced by the slice checks."""

from collections.abc import Sequence
from dataclasses import dataclass
import enum
from typing import Any

from humanopts_env.domains.base import ActableDomain
from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.option import Option
from humanopts_learner.options.learned_option import LearnedOption
import numpy as np


class CheckKind(enum.Enum):
    OUTSIDE = 1


@dataclass(frozen=True)
class Check:
    kind: Any
    text: str
    states: tuple[str, ...]
    features: tuple[tuple[float, ...], ...]
    actions: tuple[str, ...] = ()
    rewards: tuple[float, ...] = ()
    terminated: bool = False
    compared: tuple[str, ...] = ()


def next_check(
    option: LearnedOption,
    domain: ActableDomain,
    demonstrations: Sequence[Demonstration],
    rng: np.random.Generator,
    others: Sequence[Option] = (),
) -> Check | None:
    return None
