"""Multi-time models of a semi-Markov decision process (SMDP) with one outcome per choice."""

from collections.abc import Sequence
from dataclasses import dataclass

from humanopts_env.domains.base import Transitions
from humanopts_learner.planning.errors import check_gamma, ModelError, NotDeterministicError
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class SmdpModel:
    """
    What choosing option o in state s leads to. Axes: S states, O options (columns).

    A choice takes k primitive steps; its reward is sum of gamma**i * r[i], i = 0..k-1. Entries of
    pairs that are not available are ignored, but must be valid numbers. Planning reads the
    arrays options-major, so transposed (O, S) arrays are used without a copy.

    :raises ModelError: shapes disagree, a number is not finite, or an entry is out of range.
    """

    names: tuple[str, ...]  # of the columns
    reward: NDArray[np.float64]  # (S, O)
    available: NDArray[np.bool_]  # (S, O)
    successor: NDArray[np.int32]  # (S, O)
    discount: NDArray[np.float64]  # (S, O), gamma**k; 0 where the task was over

    def __post_init__(self) -> None:
        """Check the arrays."""
        shape = self.reward.shape
        for name in ('available', 'successor', 'discount'):
            if getattr(self, name).shape != shape:
                raise ModelError(f'{name} is {getattr(self, name).shape}, and reward is {shape}')
        if len(shape) != 2 or 0 in shape or shape[1] != len(self.names):
            raise ModelError(f'{len(self.names)} names do not fit arrays of shape {shape}')
        for name, array, low, high in (
            ('reward', self.reward, -np.finfo(float).max, np.finfo(float).max),
            ('successor', self.successor, 0, shape[0] - 1),
            ('discount', self.discount, 0, 1),
        ):
            if not (array.min() >= low and array.max() <= high):  # false for NaN
                raise ModelError(f'{name} holds an entry that is not within {low}..{high}')

    @property
    def n_states(self) -> int:
        """Number of states, S."""
        return int(self.reward.shape[0])


def concatenate(models: Sequence[SmdpModel]) -> SmdpModel:
    """Return one model with the columns of all, in order."""

    def columns(field: str) -> NDArray[np.generic]:
        return np.concatenate([getattr(model, field).T for model in models]).T

    return SmdpModel(
        names=tuple(name for model in models for name in model.names),
        reward=columns('reward').astype(np.float64, copy=False),
        available=columns('available').astype(np.bool_, copy=False),
        successor=columns('successor').astype(np.int32, copy=False),
        discount=columns('discount').astype(np.float64, copy=False),
    )


def check_deterministic(transitions: Transitions) -> None:
    """
    Check that every action has one outcome.

    :raises NotDeterministicError: one has more.
    """
    if not transitions.deterministic:
        raise NotDeterministicError(
            'an action of this domain has more than one outcome; exact models need a domain '
            'whose actions have one'
        )


def primitive_model(
    transitions: Transitions, over: NDArray[np.bool_], gamma: float, names: Sequence[str]
) -> SmdpModel:
    """
    Return the model whose options are the primitive actions.

    :param over: (S,) states in which nothing is available, since the task is over there.
    :param names: of the actions, (A,).
    :raises PlanError: gamma is not in (0, 1], or the transitions are not deterministic.
    """
    check_gamma(gamma)
    check_deterministic(transitions)
    reward = np.ascontiguousarray(transitions.reward[:, :, 0].T)
    ended = transitions.terminated[:, :, 0].T
    return SmdpModel(
        names=tuple(names),
        reward=reward.T,
        available=np.broadcast_to(~over, reward.shape).T,
        successor=np.ascontiguousarray(transitions.successor[:, :, 0].T).T,
        discount=np.where(ended, 0.0, gamma).T,
    )
