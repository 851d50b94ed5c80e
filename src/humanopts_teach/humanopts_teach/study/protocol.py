"""
The protocol of a study: its plan with all pages and questions, as they were used.

It is kept beside the records from the first participant on. A change is kept as a further version;
who has begun goes on with the version of that time.
"""

from collections.abc import Sequence
import difflib
import hashlib
import json
from pathlib import Path
import time
from typing import Annotated, Any, Literal

from humanopts_learner.append_only_log import AppendOnlyLog, read_lines
from humanopts_ros.limits import MOST_JSON
from humanopts_teach.study.plan import StudyPlan
from pydantic import ConfigDict, Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

FILE = 'protocol.jsonl'
SHOWN_DIGEST = 12  # characters
_CONTEXT = 5  # lines around a change
_PLAN = TypeAdapter(StudyPlan)
Digest = Annotated[str, Field(pattern='^[0-9a-f]{64}$')]


@dataclass(frozen=True, config=ConfigDict(strict=True, extra='forbid'))
class Version:
    """A protocol, from a time on."""

    time: Annotated[float, Field(ge=0, lt=1e11)]  # s since 1970
    digest: Digest
    plan: StudyPlan
    event: Literal['protocol', 'protocol changed'] = 'protocol'
    replaces: Digest | Literal[''] = ''  # digest of the version before
    diff: tuple[str, ...] = ()  # lines that differ from it, as of ``diff -u``

    def to_dict(self) -> dict[str, Any]:
        """Return the version as JSON data."""
        found: dict[str, Any] = _VERSION.dump_python(self, mode='json', exclude_none=True)
        return found


_VERSION = TypeAdapter(Version)


def digest_of(plan: StudyPlan) -> str:
    """Return the SHA-256 of all that a plan says, its pages and questions included."""
    text = json.dumps(_PLAN.dump_python(plan, mode='json', exclude_none=True), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def plan_lines(plan: StudyPlan) -> list[str]:
    """Return all that a plan says, for people: JSON in which each line of a page is one."""
    values = _PLAN.dump_python(plan, mode='json', exclude_none=True)

    def split(value: Any) -> Any:
        if isinstance(value, list):
            return [split(each) for each in value]
        if isinstance(value, dict):
            return {
                key: each.split('\n') if _is_page(key, each) else split(each)
                for key, each in value.items()
            }
        return value

    return json.dumps(split(values), indent=1, ensure_ascii=False).splitlines()


def _is_page(key: str, value: Any) -> bool:
    return isinstance(value, str) and bool(value) and (key == 'text' or '\n' in value)


def difference(old: StudyPlan, new: StudyPlan) -> list[str]:
    """Return the lines in which two plans differ, as of ``diff -u``."""
    lines = plan_lines(old), plan_lines(new)
    return list(difflib.unified_diff(*lines, 'kept', 'changed', n=_CONTEXT, lineterm=''))


class Protocol:
    """The versions of the protocol of a study, in a folder."""

    def __init__(self, folder: Path) -> None:
        """
        Read the versions.

        :ivar versions: from the first; none before the first participant.
        :ivar problems: lines that cannot be used, in words.
        :raises OSError: the file cannot be read.
        """
        self.path = folder / FILE
        self.versions: list[Version] = []
        self.problems: list[str] = []
        if self.path.exists() or self.path.is_symlink():
            self.versions, self.problems = read_lines(self.path, _version_of, MOST_JSON)

    @property
    def plan(self) -> StudyPlan | None:
        """The plan of the latest version."""
        return self.versions[-1].plan if self.versions else None

    def plan_of(self, digest: str) -> StudyPlan | None:
        """Return the plan of a version; None: it is not kept."""
        return next((each.plan for each in self.versions if each.digest == digest), None)

    def changes(self, plan: StudyPlan) -> Sequence[str]:
        """Return the lines in which a plan differs from the latest version; none: in none."""
        if self.plan is None or self.versions[-1].digest == digest_of(plan):
            return []
        return difference(self.plan, plan)

    def keep(self, plan: StudyPlan) -> None:
        """
        Keep a plan as the latest version, unless it is already.

        :raises OSError: it cannot be written.
        """
        before = self.versions[-1] if self.versions else None
        if before is not None and before.digest == digest_of(plan):
            return
        version = Version(
            time=round(time.time(), 3),
            digest=digest_of(plan),
            plan=plan,
            event='protocol' if before is None else 'protocol changed',
            replaces='' if before is None else before.digest,
            diff=() if before is None else tuple(difference(before.plan, plan)),
        )
        AppendOnlyLog(self.path).append(json.dumps(version.to_dict(), sort_keys=True))
        self.versions.append(version)


def _version_of(line: str) -> Version:
    """
    Return the version of a line.

    :raises ValueError: it is none.
    """
    try:
        version = _VERSION.validate_json(line)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        place = '.'.join(map(str, first['loc']))
        raise ValueError(f'it is no protocol: {place}: {first["msg"]}') from None
    if digest_of(version.plan) != version.digest:
        raise ValueError('its plan does not have its digest: the line has been changed')
    return version
