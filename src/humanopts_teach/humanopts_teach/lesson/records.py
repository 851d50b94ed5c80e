"""Records of a lesson on an option: demonstrations and judged runs of the machine."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any
import uuid

from humanopts_env.domains.base import ActableDomain
from humanopts_env.domains.registry import parameters_json
from humanopts_learner.demonstrations import (
    check_demonstration,
    Demonstration,
    DemonstrationError,
    judged,
    Kind,
    version_of,
)
from humanopts_learner.options.checks import Check
from humanopts_teach.lesson.attempt import Attempt, demonstration_of
from humanopts_teach.lesson.history import OptionHistory
from humanopts_teach.lesson.requests import EndDemonstration, Verdict

_NAMESPACE = uuid.uuid5(uuid.NAMESPACE_URL, 'humanopts:demonstration')


@dataclass(frozen=True)
class Records:
    """
    Creates and checks the demonstrations and judged runs of one option in one session.

    All methods raise DemonstrationError if the result is not valid.
    """

    domain: ActableDomain
    option: OptionHistory
    session: str
    method: str  # learning method

    def ended(self, attempt: Attempt, request: EndDemonstration, seconds: float) -> Demonstration:
        """
        Return a demonstration, or a run in the exam.

        :param seconds: duration of the demonstration or run.
        """
        steps, machine_steps = attempt.shown(request)
        fields = self._fields
        if attempt.exam:
            fields |= self._judged(request.verdict is Verdict.RIGHT)
        starts_again = request.can_start_at_end and request.verdict is Verdict.DONE
        return self._checked(
            demonstration_of(
                self.domain,
                steps,
                **fields,
                can_start_at_end=starts_again,
                seconds=round(seconds, 3),
                machine_steps=machine_steps,
                exam=attempt.exam,
                stopped=attempt.exam and request.stopped,
            )
        )

    def answered(self, check: Check, *, yes: bool) -> Demonstration:
        """Return the run of an answered question as a judged run."""
        return self._checked(
            Demonstration(
                uuid='',
                domain=self.domain.name,
                domain_parameters=parameters_json(self.domain),
                feature_names=tuple(feature.name for feature in self.domain.features),
                features=check.features,
                states=check.states,
                actions=check.actions,
                rewards=check.rewards,
                terminated=check.terminated,
                machine_steps=len(check.actions),
                **self._fields | self._judged(yes),
            )
        )

    def added(self, demonstrations: Sequence[Demonstration]) -> tuple[Demonstration, ...]:
        """Return demonstrations recorded elsewhere as those of this option and session."""
        if judged(demonstrations):
            raise DemonstrationError('a judged run is no demonstration')
        numbered = enumerate(demonstrations, self.option.number)
        return tuple(
            self._checked(replace(demo, **self._fields | {'number': number, 'withdrawn': False}))
            for number, demo in numbered
        )

    def renamed(self, name: str, number: int) -> Iterator[Demonstration]:
        """
        Yield copies of all demonstrations and judged runs under another option name.

        :param number: number of the first demonstration.
        """
        old, fields = version_of(self.option.demonstrations), dict[str, Any](option_name=name)
        numbered = enumerate(self.option.demonstrations, number)
        moved = [with_uuid(replace(demo, **fields, number=n)) for n, demo in numbered]
        yield from moved
        new = version_of(moved)
        for run in self.option.judged:
            version = new if run.option_version == old else run.option_version
            yield with_uuid(replace(run, **fields, option_version=version))

    @property
    def _fields(self) -> dict[str, Any]:
        return {
            'participant': self.option.participant,
            'session': self.session,
            'option_name': self.option.name,
            'number': self.option.number,
            'chosen_features': self.option.chosen,
            'method': self.method,
        }

    def _judged(self, right: bool) -> dict[str, Any]:
        """Return the additional fields of a judged run."""
        return {
            'kind': Kind.JUDGED,
            'number': self.option.judged_number,
            'right': right,
            'option_version': version_of(self.option.demonstrations),
        }

    def _checked(self, draft: Demonstration) -> Demonstration:
        demo = with_uuid(draft)
        check_demonstration(demo, self.domain)
        return demo


def with_uuid(demo: Demonstration) -> Demonstration:
    """
    Return a demonstration with a uuid computed from its content, excluding ``seconds``.

    Thus the same lesson with the same seed has the same uuids, and the same folds in learning.
    """
    draft = replace(demo, uuid='', seconds=0.0)
    return replace(demo, uuid=str(uuid.uuid5(_NAMESPACE, draft.to_json())))
