"""The settings of a recorded lesson, from the facts in its bag."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from humanopts_learner.options.criteria import Thresholds


@dataclass(frozen=True)
class Settings:
    """What learning and judging depend on beside the demonstrations."""

    seed: int = 0
    thresholds: Thresholds = field(default_factory=Thresholds)
    strategy: str = 'failures'  # of start states
    budget: int = 150  # most start states shown for one option
    teacher_error_rate: float | None = None  # None: a person taught

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as JSON data."""
        return {
            'seed': self.seed,
            'strategy': self.strategy,
            'thresholds': thresholds_dict(self.thresholds),
            'teacher_error_rate': self.teacher_error_rate,
            'budget': self.budget,
        }


def thresholds_dict(thresholds: Thresholds) -> dict[str, float]:
    """Return the thresholds by name."""
    return {part.name: float(getattr(thresholds, part.name)) for part in fields(thresholds)}


def settings_from_facts(facts: Mapping[str, str]) -> tuple[Settings, list[str]]:
    """
    Read the settings, with a default for each that is missing or unreadable.

    :return: the settings, and in words what had to be assumed.
    """
    assumed: list[str] = []

    def read(name: str, kind: Callable[[str], Any], default: Any) -> Any:
        try:
            return kind(facts[name])
        except KeyError:
            assumed.append(f'the bag does not say its {name}; {default} is assumed')
        except ValueError:
            assumed.append(f'its {name} {facts[name]!r} is not valid; {default} is assumed')
        return default

    usual = Settings()
    limits = thresholds_dict(usual.thresholds)
    settings = Settings(
        seed=read('seed', _natural, usual.seed),
        thresholds=Thresholds(
            **{name: read(name, _threshold(name), limits[name]) for name in limits}
        ),
        strategy=read('strategy', str, usual.strategy),
        budget=read('budget', _natural, usual.budget),
        teacher_error_rate=read('teacher_error_rate', _rate, usual.teacher_error_rate),
    )
    return settings, assumed


def _natural(text: str) -> int:
    value = int(text)
    if value < 0:
        raise ValueError(text)
    return value


def _threshold(name: str) -> Callable[[str], float]:
    def read(text: str) -> float:
        value: float = getattr(Thresholds(**{name: float(text)}), name)
        return value

    return read


def _rate(text: str) -> float | None:
    if text == 'None':
        return None
    value = float(text)
    if not 0 <= value <= 1:
        raise ValueError(text)
    return value
