"""Settings of learning and evaluation."""

from collections.abc import Mapping
from dataclasses import asdict, field, fields, replace
from typing import Annotated, Any

from humanopts_learner.options.judge import Thresholds
from humanopts_teach.lesson import BUDGET, STRATEGY
from pydantic import Field, NonNegativeInt
from pydantic.dataclasses import dataclass


@dataclass(frozen=True)
class EvaluationSettings:
    """
    Settings of learning and evaluation.

    :raises ValueError: a number is out of range.
    """

    seed: NonNegativeInt = 0
    strategy: str = STRATEGY  # strategy of the start-state choice
    thresholds: Thresholds = field(default_factory=Thresholds)
    teacher_error_rate: Annotated[float, Field(ge=0, le=1)] | None = None  # None: human teacher
    budget: NonNegativeInt = BUDGET  # maximum number of start states per option
    game_steps: NonNegativeInt = 0  # number per plan; 0: the planner's default
    unstick: bool = True  # whether options take random actions to leave loops

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as JSON data, without game steps, which are stored with plans."""
        return {name: value for name, value in asdict(self).items() if name != 'game_steps'}


def settings_from_facts(facts: Mapping[str, str]) -> tuple[EvaluationSettings, list[str]]:
    """
    Read the settings; use the default for missing or unreadable ones.

    :return: the settings, and a sentence on each default used.
    """
    settings, assumed = EvaluationSettings(), []
    limits = [each.name for each in fields(Thresholds)]
    names = ['seed', *limits, 'strategy', 'budget', 'teacher_error_rate']
    for name in [*names, *({'game_steps', 'unstick'} & {*facts})]:
        usual = getattr(settings.thresholds if name in limits else settings, name)
        try:
            text = facts[name]
            value: Any = None if usual is None and text == 'None' else text
            if name in limits:
                value = value and type(usual or 0.0)(value)
                thresholds = replace(settings.thresholds, **{name: value})
                settings = replace(settings, thresholds=thresholds)
            else:
                settings = replace(settings, **{name: value})
        except KeyError:
            assumed.append(f'the bag does not say its {name}; {usual} is assumed')
        except ValueError:
            assumed.append(f'its {name} {facts[name]!r} is not valid; {usual} is assumed')
    return settings, assumed
