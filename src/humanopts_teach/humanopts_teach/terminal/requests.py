"""What the terminal asks of the graph, and when the graph has caught up with the answer."""

from dataclasses import dataclass

from humanopts_teach.dialogue.answers import Phase, Verdict
from humanopts_teach.terminal.world import World


@dataclass(frozen=True, slots=True)
class OpenSession:
    """Begin a sitting, or go on with the participant's options."""

    participant: str


@dataclass(frozen=True, slots=True)
class DefineOption:
    """Name an option, or take it up again."""

    name: str
    ask_again: bool = False


@dataclass(frozen=True, slots=True)
class AnswerQuestion:
    """Answer the open question."""

    question_id: int
    yes: bool


@dataclass(frozen=True, slots=True)
class Begin:
    """Draw a start state and begin a demonstration."""


@dataclass(frozen=True, slots=True)
class End:
    """Give the verdict on the demonstration under way."""

    verdict: Verdict
    at: tuple[int, int]  # episode and step that the person saw
    can_start_at_end: bool = False


@dataclass(frozen=True, slots=True)
class Withdraw:
    """Take back the newest demonstration of the option."""

    uuid: str


@dataclass(frozen=True, slots=True)
class Drive:
    """Take one primitive action as a person, and so take control."""

    action: str
    at: tuple[int, int]  # episode and step that the person saw


@dataclass(frozen=True, slots=True)
class SetControl:
    """Take control, or give it back to the machine."""

    hold: bool


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
    OpenSession
    | DefineOption
    | AnswerQuestion
    | Begin
    | End
    | Withdraw
    | Drive
    | SetControl
    | NewEpisode
    | ListOptions
    | SetExecution
    | CancelRun
    | Run
)


@dataclass(frozen=True, slots=True)
class Reply:
    """The answer to one request; for a run, that it was accepted or not."""

    request: Request
    ok: bool
    text: str = ''
    names: tuple[str, ...] = ()  # options, where the request was about them
    episode: int = 0  # that was begun


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
        case OpenSession(participant):
            return lesson is not None and lesson.participant == participant
        case DefineOption(name):
            return lesson is not None and lesson.option_name == name
        case AnswerQuestion(question_id):
            return lesson is not None and lesson.question_id != question_id
        case Begin():
            begun = lesson is not None and lesson.phase is Phase.DEMONSTRATING
            return begun and game is not None and game.episode >= reply.episode
        case End():
            return lesson is not None and lesson.phase is not Phase.DEMONSTRATING
        case Withdraw(uuid):
            return lesson is not None and lesson.last_uuid != uuid
        case NewEpisode():
            return game is not None and game.episode >= reply.episode
        case SetExecution(execution):
            return world.execution == execution
        case SetControl(hold):
            return world.i_drive == hold
        case _:
            return True
