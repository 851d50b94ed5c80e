"""The feature questions of one option, and the answers so far."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from humanopts_env.domains.base import Feature


def question_text(option_name: str, feature: Feature) -> str:
    """Return the question as the paper words it (section 5)."""
    return f"Does the '{option_name}' option depend on {feature.question}?"


@dataclass(frozen=True)
class Questions:
    """One question for each feature; when all are answered no, they are asked again."""

    option_name: str
    features: Sequence[Feature]
    answers: Mapping[str, bool] = field(default_factory=dict)
    earlier: tuple[str, ...] = ()  # chosen before they were asked again

    @property
    def open(self) -> Feature | None:
        """The feature that is asked about next; None: all are answered."""
        return next((f for f in self.features if f.name not in self.answers), None)

    @property
    def chosen(self) -> tuple[str, ...]:
        """Features answered yes, in the domain's order."""
        return tuple(f.name for f in self.features if self.answers.get(f.name, False))

    def answered(self, feature: str, yes: bool) -> 'Questions':
        """Return the questions after one more answer; after the last "no" of all, none is kept."""
        answers = {**self.answers, feature: yes}
        if all(answers.get(f.name) is False for f in self.features):
            answers = {}
        return replace(self, answers=answers)

    def again(self) -> 'Questions':
        """Return the questions with no answer; what was chosen when all had one is kept beside."""
        earlier = self.chosen if self.open is None else self.earlier
        return Questions(self.option_name, self.features, earlier=earlier)
