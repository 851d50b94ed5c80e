"""What the terminal knows of the graph: plain values, named like the messages that carry them."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_teach.dialogue.answers import LessonView


@dataclass(frozen=True, slots=True)
class GameView:
    """The current state of the game, as in GameState."""

    episode: int  # 0: none was begun yet
    step: int
    state: str  # in the domain's notation
    action: str = ''  # that led here
    reward: float = 0.0  # of that step
    terminated: bool = False
    truncated: bool = False

    @property
    def under_way(self) -> bool:
        """Whether a step can be taken."""
        return self.episode > 0 and not self.terminated and not self.truncated

    @property
    def at(self) -> tuple[int, int]:
        """Episode and step."""
        return self.episode, self.step


@dataclass(frozen=True, slots=True)
class CriterionView:
    """One stopping criterion, as in Criterion."""

    name: str
    value: float
    threshold: float
    measurable: bool
    met: bool


@dataclass(frozen=True, slots=True)
class ProgressView:
    """How far one option is learned, as in OptionStatus."""

    option_name: str
    participant: str
    features: tuple[str, ...] = ()
    n_demonstrations: int = 0
    n_not_here: int = 0
    criteria: tuple[CriterionView, ...] = ()
    criteria_met: bool = False
    mean_return_demonstrations: float = float('nan')
    mean_return_policy: float = float('nan')
    more_needed: int = -1  # -1: cannot be told yet
    conflicts: tuple[str, ...] = ()
    suggested_feature: str = ''


@dataclass
class World:
    """The newest of everything; None until it has come."""

    domain: Domain[Any] | None = None
    game: GameView | None = None
    lesson: LessonView | None = None
    progress: Sequence[ProgressView] = ()
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

    def progress_of(self, participant: str, option_name: str) -> ProgressView | None:
        """Return what the learner says of one option; None: nothing yet."""
        wanted = (participant, option_name)
        return next((p for p in self.progress if (p.participant, p.option_name) == wanted), None)
