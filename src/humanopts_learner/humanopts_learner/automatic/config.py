"""The parameters of the search for options, each with its source."""

from collections.abc import Callable
from dataclasses import dataclass, fields

from humanopts_learner.planning.request import PlanError

# Called with the stage (tasks or policies), the share done (0..1) and the game steps so far;
# raises ``PlanCanceled`` to stop
Progress = Callable[[str, float, int], object]


@dataclass(frozen=True)
class Extraction:
    """
    The parameters of the search for options.

    M. Stolle and D. Precup (2002), "Learning Options in Reinforcement Learning", give the
    algorithm. The numbers marked "usual" are those of another implementation
    (utkd/bottleneck-options-learning); the others are ours, with their reasons.
    """

    options: int = 25  # largest number
    tasks: int = 400  # usual: 20, where some bottlenecks were missed
    train_episodes: int = 200  # of Q-learning for each task, N_train: usual
    test_runs: int = 10  # greedy ones for each task, N_test: usual
    option_episodes: int = 2000  # for each option; usual: 200, but these begin all over I
    learning_rate: float = 0.1  # usual
    explore: float = 0.1  # share of random actions while learning: usual
    gamma: float = 0.9  # while learning: usual; the reward is 1 at the target, 0 elsewhere
    max_steps: int = 1000  # after which an episode or a greedy run is cut off: ours

    def __post_init__(self) -> None:
        """
        Check the numbers.

        :raises PlanError: one is out of range.
        """
        for field in fields(self):
            value = getattr(self, field.name)
            if field.type is int and value < 1:
                raise PlanError(f'{field.name} is {value}, and must be 1 or more')
            if field.type is float and not 0.0 <= value <= 1.0:
                raise PlanError(f'{field.name} is {value}, and must be from 0 to 1')


USUAL = Extraction()


def ignore_progress(stage: str, fraction: float, game_steps: int) -> None:
    """Ignore the progress."""
