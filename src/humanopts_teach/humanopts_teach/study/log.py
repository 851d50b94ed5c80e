"""The log of a study: events of people without a record."""

from functools import partial
from pathlib import Path
import time
from typing import Annotated, ClassVar, Literal

from humanopts_learner.append_only_log import AppendOnlyLog, read_lines
from humanopts_ros.text_files import model_of
from pydantic import BaseModel, ConfigDict, Field

FILE = 'log.jsonl'
LogEvent = Literal[
    'declined',  # a person did not agree to take part
    'full',  # a person arrived when all places were taken
    'withdrawn',  # the data of a participant were deleted
]


class LogEntry(BaseModel):
    """An event of the log; it never contains a participant's code."""

    model_config: ClassVar[ConfigDict] = ConfigDict(strict=True, frozen=True)

    event: LogEvent
    time: Annotated[float, Field(ge=0, lt=1e11)]  # s since 1970
    people: Annotated[int, Field(ge=-1, le=1)] = 1  # -1: cancels an entry, as the person returned
    number: Annotated[int, Field(ge=0)] | None = None  # of the participant; None: unknown
    place: Annotated[int, Field(ge=0)] | None = None  # of the participant
    files: Annotated[int, Field(ge=0)] = 0  # number of deleted files


class StudyLog:
    """
    The log in the folder of a study.

    :ivar entries: events, oldest first.
    :ivar problems: descriptions of invalid lines.
    """

    def __init__(self, folder: Path) -> None:
        """
        Read the log, which need not exist.

        :raises OSError: the file cannot be read.
        """
        self.path = folder / FILE
        self.entries, self.problems = read_lines(
            self.path, partial(model_of, LogEntry, 'an entry of a log')
        )

    def people(self, event: LogEvent) -> int:
        """Return the number of people; repeated deletions count once."""
        found = [entry for entry in self.entries if entry.event == event]
        if event == 'withdrawn':
            return len({entry.number for entry in found})
        return sum(entry.people for entry in found)

    def note(self, event: LogEvent, **values: int) -> None:
        """
        Append an event.

        :raises OSError: the event could not be written.
        """
        entry = LogEntry(event=event, time=round(time.time(), 3), **values)
        AppendOnlyLog(self.path).append(entry.model_dump_json(exclude_unset=True))
        self.entries.append(entry)
