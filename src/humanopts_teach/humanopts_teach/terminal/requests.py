"""What the terminal asks of the graph, and when the graph has caught up with the answer."""

from dataclasses import dataclass

from humanopts_teach.lesson.requests import (
    Answer,
    BeginDemonstration,
    Drive,
    LessonRequest,
    RequestStatus,
    SetControl,
    shows_outcome,
)
from humanopts_teach.terminal.world import World

_NO_FIELDS = Answer(RequestStatus.OK, '')


@dataclass(frozen=True, slots=True)
class NewEpisode:
    """Begin an episode from a start state of the task."""

    seed: int


@dataclass(frozen=True, slots=True)
class ListOptions:
    """Ask the option server what the participant's options are."""

    participant: str


@dataclass(frozen=True, slots=True)
class RunOption:
    """Have the machine run a taught option from the current state."""

    name: str
    participant: str


@dataclass(frozen=True, slots=True)
class PlanOptions:
    """Have the planner plan."""

    action_set: str
    participant: str
    seed: int


@dataclass(frozen=True, slots=True)
class PlayEpisodes:
    """Have the planner play by its plan."""

    action_set: str
    participant: str
    episodes: int
    seed: int
    execution: str


@dataclass(frozen=True, slots=True)
class SetExecution:
    """Have the policy that runs carried out in another way, from its next action on."""

    execution: str


@dataclass(frozen=True, slots=True)
class CancelRun:
    """Ask for the end of the run under way."""


Run = RunOption | PlanOptions | PlayEpisodes  # long: they go on after they were accepted
Request = (
    LessonRequest | Drive | SetControl | NewEpisode | ListOptions | SetExecution | CancelRun | Run
)


@dataclass(frozen=True, slots=True)
class Reply:
    """The answer to one request; for a run, that it was accepted or not."""

    request: Request
    ok: bool
    text: str = ''
    names: tuple[str, ...] = ()  # options, where the request was about them
    answer: Answer = _NO_FIELDS  # the fields of the service's response


def server(request: Request) -> str:
    """Return the node that answers a request."""
    match request:
        case Drive() | SetControl() | NewEpisode():
            return 'game'
        case ListOptions() | RunOption():
            return 'option_server'
        case PlanOptions() | PlayEpisodes() | SetExecution():
            return 'planner'
        case CancelRun():
            return 'option_server or planner'
        case _:
            return 'lesson'


def settled(reply: Reply, world: World) -> bool:
    """Tell whether the latched topics show what a request that went well has changed."""
    lesson, game = world.lesson, world.game
    if not reply.ok:
        return True
    match reply.request:
        case Drive() | ListOptions() | CancelRun() | RunOption() | PlanOptions() | PlayEpisodes():
            return True
        case NewEpisode():
            return game is not None and game.episode >= reply.answer.episode
        case SetExecution(execution):
            return world.execution == execution
        case SetControl(hold):
            return world.i_drive == hold
        case BeginDemonstration() if game is None or game.episode < reply.answer.episode:
            return False
        case request:
            return lesson is not None and shows_outcome(lesson, request, reply.answer)
