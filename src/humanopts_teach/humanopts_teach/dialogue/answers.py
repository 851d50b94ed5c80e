"""What the lesson answers and shows: plain values, named like the messages that carry them."""

from dataclasses import dataclass
from enum import Enum

from humanopts_learner.demonstrations import Demonstration


class Status(Enum):
    """How a request ended; the names are those of the services' STATUS constants."""

    OK = 'ok'
    BAD_NAME = 'bad name'
    BAD_STATE = 'bad state'
    BAD_VERDICT = 'bad verdict'
    BUDGET_SPENT = 'budget spent'
    NOT_ASKED = 'not asked'
    NOT_CURRENT = 'not current'
    NOT_SAVED = 'not saved'
    NO_DEMONSTRATION = 'no demonstration'
    NO_FEATURE = 'no feature'
    NO_GAME = 'no game'
    NO_STEPS = 'no steps'
    PAUSED = 'paused'
    REFUSED = 'refused'
    STEPS_TAKEN = 'steps taken'
    WRONG_PHASE = 'wrong phase'


class Phase(Enum):
    """Where the lesson stands; the names are those of LessonState's PHASE constants."""

    NO_SESSION = 'no session'
    NO_OPTION = 'no option'
    ASKING = 'asking'
    READY = 'ready'
    DEMONSTRATING = 'demonstrating'
    LEARNING = 'learning'
    FINISHED = 'finished'


class Verdict(Enum):
    """What becomes of a demonstration; the names are those of EndDemonstration's constants."""

    DONE = 'done'
    NOT_HERE = 'not here'
    DISCARD = 'discard'


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer to one request; the fields that it does not concern are empty."""

    status: Status
    detail: str
    session: str = ''
    known_options: tuple[str, ...] = ()
    resumed: bool = False
    state: str = ''  # start state, in the domain's notation
    seed: int = 0  # of the chance in the episode
    demonstration: Demonstration | None = None  # that was kept, or taken back

    @property
    def ok(self) -> bool:
        """Whether the request was carried out."""
        return self.status is Status.OK


@dataclass(frozen=True, slots=True)
class Progress:
    """What the learner says of one option, as far as the lesson needs it."""

    participant: str
    option_name: str
    features: tuple[str, ...]
    last_uuid: str  # newest demonstration that is counted in
    criteria_met: bool


@dataclass(frozen=True, slots=True)
class LessonView:
    """Where the lesson stands, as in LessonState."""

    phase: Phase
    participant: str = ''
    session: str = ''
    option_name: str = ''
    question_id: int = 0  # 0: none is open
    question: str = ''
    question_feature: str = ''
    questions_total: int = 0
    chosen_features: tuple[str, ...] = ()
    earlier_features: tuple[str, ...] = ()  # before the questions were asked again
    n_demonstrations: int = 0
    n_not_here: int = 0
    last_uuid: str = ''  # of the newest demonstration; empty: none
    budget: int = 0
    strategy: str = ''
    start_state: str = ''
    episode: int = 0
    criteria_met: bool = False
    paused: str = ''  # why nothing new can be begun; empty: it can
    text: str = ''
