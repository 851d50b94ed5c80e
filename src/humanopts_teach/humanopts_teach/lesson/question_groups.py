"""Questions about groups of features, which spare the person questions about each feature."""

from enum import Enum

from humanopts_env.domains.base import ActableDomain
from humanopts_env.domains.capabilities import feature_groups, FeatureGroup
from humanopts_teach.lesson.requests import LessonView


class GroupAnswer(Enum):
    """The answer to the questions about all features of a group."""

    EACH = 'each is asked'
    NONE = 'no to all'
    AS_BEFORE = 'all as before'  # if the questions are asked again


class QuestionGroups:
    """
    Answers about groups of features, for the questions of one option.

    The lesson asks about one feature at a time. A screen first asks about ``open_group``, and
    answers with ``reply`` if the group settles the question. It calls ``withdraw`` to reopen a
    question, and ``forget`` when the questions restart or the option changes.
    """

    def __init__(self) -> None:
        self._answers: dict[str, GroupAnswer] = {}  # by wording of the group

    def open_group(self, domain: ActableDomain, lesson: LessonView) -> FeatureGroup | None:
        """Return the group to ask about; None: ask the lesson's own question."""
        group, answer = self.asked(domain, lesson)
        return group if answer is None else None

    def answer(self, group: FeatureGroup, answer: GroupAnswer) -> None:
        """Store the answer about a group."""
        self._answers[group.words] = answer

    def reply(self, domain: ActableDomain, lesson: LessonView) -> bool | None:
        """Return the answer to the open question; None: ask the person."""
        _, answer = self.asked(domain, lesson)
        if answer is None or answer is GroupAnswer.EACH:
            return None
        return (
            answer is GroupAnswer.AS_BEFORE and lesson.question_feature in lesson.earlier_features
        )

    def withdraw(self, group: FeatureGroup) -> None:
        """Ask about a group again."""
        self._answers.pop(group.words, None)

    def forget(self) -> None:
        """Ask about every group again."""
        self._answers.clear()

    def asked(
        self, domain: ActableDomain, lesson: LessonView
    ) -> tuple[FeatureGroup | None, GroupAnswer | None]:
        """Return the group of the open question, and its answer; None: no group or answer."""
        feature = lesson.question_feature
        group = next((each for each in feature_groups(domain) if feature in each.features), None)
        return group, self._answers.get(group.words) if group is not None else None
