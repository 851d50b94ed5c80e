"""What a teacher can do next; each is one request or one key, as a person's would be."""

from dataclasses import dataclass

from humanopts_env.game import Transition
from humanopts_teach.dialogue.answers import LessonView, Verdict


@dataclass(frozen=True, slots=True)
class Open:
    """Open a session."""

    participant: str
    session: str


@dataclass(frozen=True, slots=True)
class Define:
    """Name an option."""

    option_name: str


@dataclass(frozen=True, slots=True)
class Reply:
    """Answer a question."""

    question_id: int
    yes: bool


@dataclass(frozen=True, slots=True)
class Begin:
    """Ask for a start state."""


@dataclass(frozen=True, slots=True)
class Drive:
    """Take one primitive action in the state of ``episode`` and ``step``."""

    action: str
    episode: int
    step: int


@dataclass(frozen=True, slots=True)
class End:
    """Give the verdict in the state of ``episode`` and ``step``."""

    verdict: Verdict
    episode: int
    step: int
    can_start_at_end: bool = False


@dataclass(frozen=True, slots=True)
class Wait:
    """Do nothing until something changes."""

    reason: str  # completes "waits for ..."


@dataclass(frozen=True, slots=True)
class Finish:
    """Everything was taught."""


Act = Open | Define | Reply | Begin | Drive | End | Wait | Finish


def is_seen(act: Act, lesson: LessonView, game: Transition | None, episode: int = 0) -> bool:
    """
    Tell whether lesson and game show what came of an act.

    :param episode: which episode the lesson answered to ``Begin``.
    """
    match act:
        case Open():
            return (lesson.participant, lesson.session) == (act.participant, act.session)
        case Define():
            return lesson.option_name == act.option_name
        case Reply():
            return lesson.question_id != act.question_id
        case Begin():
            return lesson.episode == episode
        case Drive():
            return game is not None and (game.episode, game.step) > (act.episode, act.step)
        case End():
            return lesson.episode != act.episode
        case Wait() | Finish():
            return True
