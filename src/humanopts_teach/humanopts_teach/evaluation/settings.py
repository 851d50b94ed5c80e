"""Settings of learning and judging."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any

from humanopts_learner.options.judge import Thresholds
from humanopts_teach.lesson import BUDGET, STRATEGY


@dataclass(frozen=True)
class Settings:
    """Settings of learning and judging."""

    seed: int = 0
    strategy: str = STRATEGY  # of start states
    thresholds: Thresholds = field(default_factory=Thresholds)
    teacher_error_rate: float | None = None  # None: a person taught
    budget: int = BUDGET  # most start states shown for one option
    game_steps: int = 0  # that plans are sampled from; 0: the planner's default

    def __post_init__(self) -> None:
        """
        Check the numbers.

        :raises ValueError: one is out of range.
        """
        numbers = self.seed, self.budget, self.game_steps
        if min(numbers) < 0 or not 0 <= (self.teacher_error_rate or 0.0) <= 1:
            raise ValueError(f'{self}: a number is below 0, or the rate is not a share')

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as JSON data, without the game steps, which each plan has."""
        return {name: value for name, value in asdict(self).items() if name != 'game_steps'}


def settings_from_facts(facts: Mapping[str, str]) -> tuple[Settings, list[str]]:
    """
    Read the settings, with a default for each that is missing or unreadable.

    :return: the settings, and a sentence on each default.
    """
    settings, assumed = Settings(), []
    limits = [each.name for each in fields(Thresholds)]
    names = ['seed', *limits, 'strategy', 'budget', 'teacher_error_rate']
    for name in [*names, *({'game_steps'} & {*facts})]:
        usual = getattr(settings.thresholds if name in limits else settings, name)
        try:
            text = facts[name]
            kind = str if name == 'strategy' else int if type(usual) is int else float
            value: Any = None if usual is None and text == 'None' else kind(text)
            if name in limits:
                settings = replace(
                    settings, thresholds=replace(settings.thresholds, **{name: value})
                )
            else:
                settings = replace(settings, **{name: value})
        except KeyError:
            assumed.append(f'the bag does not say its {name}; {usual} is assumed')
        except ValueError:
            assumed.append(f'its {name} {facts[name]!r} is not valid; {usual} is assumed')
    return settings, assumed
