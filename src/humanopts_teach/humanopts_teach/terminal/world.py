"""What the terminal knows of the graph: plain values, named like the messages that carry them."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.game import Transition
from humanopts_teach.lesson.requests import LessonView, OptionStatus


@dataclass
class World:
    """The newest of everything; None until it has come."""

    domain: Domain[Any] | None = None
    game: Transition | None = None
    lesson: LessonView | None = None
    progress: Sequence[OptionStatus] = ()
    running: str = ''  # what option_server took on last: an option, or action:NAME
    execution: str = ''  # of the policy that runs or ran last; empty: none did
    holder: str = ''  # publisher_id of the terminal that drives; empty: nobody
    me: str = ''  # our own publisher_id
    missing: Sequence[str] = field(default_factory=tuple)  # nodes that are gone or have not come

    @property
    def paused(self) -> str:
        """Why nothing new can be taught now; empty: it can."""
        return self.lesson.paused if self.lesson is not None else ''

    @property
    def i_drive(self) -> bool:
        """Whether this terminal holds control."""
        return bool(self.me) and self.holder == self.me

    def progress_of(self, participant: str, option_name: str) -> OptionStatus | None:
        """Return what the learner says of one option; None: nothing yet."""
        wanted = (participant, option_name)
        return next((p for p in self.progress if (p.participant, p.option_name) == wanted), None)
