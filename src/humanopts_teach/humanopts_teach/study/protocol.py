"""
The protocol of a study: the plan as used, including all pages and questions.

It is stored with the records when the first participant begins. Changed plans are stored as new
versions; participants continue with the version with which they began.
"""

import difflib
from functools import partial
import hashlib
from importlib.metadata import version as version_of
import json
from pathlib import Path
import time
from typing import Annotated, Any, ClassVar, Literal, Self

from humanopts_learner.append_only_log import AppendOnlyLog, read_lines
from humanopts_ros.limits import MAX_JSON
from humanopts_ros.text_files import model_of
from humanopts_teach.study.plan import StudyPlan
from pydantic import BaseModel, ConfigDict, Field, model_validator

FILE = 'protocol.jsonl'
SOFTWARE = version_of('humanopts_teach')
SHOWN_DIGEST = 12  # characters
_CONTEXT = 5  # context lines of a diff


class Version(BaseModel):
    """A version of the protocol and the time at which it was stored."""

    model_config: ClassVar[ConfigDict] = ConfigDict(strict=True, frozen=True, extra='forbid')

    time: Annotated[float, Field(ge=0, lt=1e11)]  # s since 1970
    digest: str
    plan: StudyPlan
    software: str = ''  # version of humanopts
    event: Literal['protocol', 'protocol changed'] = 'protocol'
    replaces: str = ''  # digest of the previous version
    diff: tuple[str, ...] = ()  # unified diff from the previous version

    @model_validator(mode='after')
    def _unchanged(self) -> Self:
        if digest_of(self.plan) != self.digest:
            raise ValueError('its plan does not have its digest: the line has been changed')
        return self


def digest_of(plan: StudyPlan) -> str:
    """Return the SHA-256 digest of a plan, including its pages and questions."""
    text = json.dumps(plan.model_dump(mode='json', exclude_none=True), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def difference(old: StudyPlan, new: StudyPlan) -> list[str]:
    """Return the unified diff of two plans; pages are split into lines."""
    lines = _lines(old), _lines(new)
    return list(difflib.unified_diff(*lines, 'kept', 'changed', n=_CONTEXT, lineterm=''))


def _lines(plan: StudyPlan) -> list[str]:
    def split(value: Any) -> Any:
        match value:
            case list():
                return [split(each) for each in value]
            case dict():
                return {key: split(each) for key, each in value.items()}
            case str() if '\n' in value:
                return value.split('\n')
        return value

    values = split(plan.model_dump(mode='json', exclude_none=True))
    return json.dumps(values, indent=1, ensure_ascii=False).splitlines()


class Protocol:
    """
    The versions of a study's protocol, in a folder.

    :ivar versions: versions, oldest first; empty before the first participant.
    :ivar problems: descriptions of invalid lines.
    """

    def __init__(self, folder: Path) -> None:
        """
        Read the versions.

        :raises OSError: the file cannot be read.
        """
        self.path = folder / FILE
        self.versions, self.problems = read_lines(
            self.path, partial(model_of, Version, 'a protocol'), MAX_JSON
        )

    @property
    def plan(self) -> StudyPlan | None:
        """The plan of the latest version."""
        return self.versions[-1].plan if self.versions else None

    def plan_of(self, digest: str) -> StudyPlan | None:
        """Return the plan with this digest; None: not stored."""
        return next((each.plan for each in self.versions if each.digest == digest), None)

    def keep(self, plan: StudyPlan) -> None:
        """
        Store a plan as the latest version, unless it is unchanged.

        :raises OSError: the file cannot be written.
        """
        now, digest = round(time.time(), 3), digest_of(plan)
        version = Version(time=now, digest=digest, plan=plan, software=SOFTWARE)
        if self.plan is not None:
            before, diff = self.versions[-1].digest, tuple(difference(self.plan, plan))
            if before == version.digest:
                return
            change = {'event': 'protocol changed', 'replaces': before, 'diff': diff}
            version = version.model_copy(update=change)
        AppendOnlyLog(self.path).append(version.model_dump_json(exclude_none=True))
        self.versions.append(version)
