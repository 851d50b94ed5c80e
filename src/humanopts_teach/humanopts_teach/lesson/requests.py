"""
Requests to the lesson and its neighbouring nodes, their answers, and the data of terminals.

All are plain values with the names and fields of the corresponding ``.srv``, ``.action`` and
``.msg`` files of humanopts_interfaces. Terminals, the simulated teacher, other programs and the
lesson itself share them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum

from humanopts_env.domains.base import ActableDomain
from humanopts_env.domains.capabilities import StepEffect
from humanopts_env.domains.described import can_simulate
from humanopts_env.game import effect_between, Source, Transition
from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.summary import OptionSummary


class Phase(Enum):
    """The phase of the lesson; names match LessonState's PHASE constants."""

    NO_SESSION = 'no session'
    NO_OPTION = 'no option'
    ASKING = 'asking'
    READY = 'ready'
    DEMONSTRATING = 'demonstrating'
    LEARNING = 'learning'
    FINISHED = 'finished'
    CHECKING = 'checking'
    EXAM = 'exam'


class Verdict(Enum):
    """The verdict on a demonstration; names match EndDemonstration's constants."""

    DONE = 'done'
    NOT_HERE = 'not here'
    DISCARD = 'discard'
    RIGHT = 'right'
    WRONG = 'wrong'


class RequestStatus(Enum):
    """The status of an answer; names match the services' STATUS constants."""

    UNKNOWN = 'unknown'
    OK = 'ok'
    BAD_FEATURE = 'bad feature'
    BAD_METHOD = 'bad method'
    BAD_NAME = 'bad name'
    BAD_PERIOD = 'bad period'
    BAD_REQUEST = 'bad request'
    BAD_SOURCE = 'bad source'
    BAD_STATE = 'bad state'
    BAD_VERDICT = 'bad verdict'
    BUDGET_SPENT = 'budget spent'
    FAILED = 'failed'
    HELD_BY_PERSON = 'held by person'
    NAME_TAKEN = 'name taken'
    NOT_ASKED = 'not asked'
    NOT_CURRENT = 'not current'
    NOT_HOLDER = 'not holder'
    NOT_SAVED = 'not saved'
    NO_DEMONSTRATION = 'no demonstration'
    NO_FEATURE = 'no feature'
    NO_GAME = 'no game'
    NO_OPTION = 'no option'
    NO_RUN = 'no run'
    NO_STEPS = 'no steps'
    PAUSED = 'paused'
    REFUSED = 'refused'
    STEPS_TAKEN = 'steps taken'
    UNKNOWN_PARTICIPANT = 'unknown participant'
    WRONG_PHASE = 'wrong phase'


@dataclass(frozen=True, slots=True)
class OpenSession:
    """Open a session of one participant, or resume it."""

    participant: str
    session: str = ''  # empty: today's date and a number


@dataclass(frozen=True, slots=True)
class DefineOption:
    """Name a new option to teach, or resume an existing one."""

    name: str
    ask_again: bool = False  # repeat the feature questions
    method: str = ''  # learning method for future demonstrations; empty: unchanged
    derived_features: tuple[str, ...] = ()  # formulas to add as features of the participant


@dataclass(frozen=True, slots=True)
class AnswerQuestion:
    """Answer the open question, about a feature or a run, or return to the previous one."""

    question_id: int  # of the open question; 0: none is open
    yes: bool = False
    back: bool = False  # withdraw the last answer


@dataclass(frozen=True, slots=True)
class BeginDemonstration:
    """Choose a start state and begin an episode there."""

    start_state: str = ''  # in the domain's notation; empty: chosen by the lesson
    watch: bool = False  # the machine may move until the person moves
    exam: bool = False  # the machine moves, and the person judges its run


@dataclass(frozen=True, slots=True)
class EndDemonstration:
    """End the current demonstration with a verdict."""

    verdict: Verdict | None  # None: unknown verdict in the request
    episode: int  # of the last state that the person saw
    step: int
    can_start_at_end: bool = False  # with DONE: the option could start again there
    count_machine_steps: bool = False  # with DONE: record machine steps before the person's too
    stopped: bool = False  # with WRONG: the person stopped the run here


@dataclass(frozen=True, slots=True)
class AddDemonstrations:
    """Add demonstrations of the option that were recorded elsewhere."""

    demonstrations: tuple[Demonstration, ...]  # the lesson sets number, participant and session


@dataclass(frozen=True, slots=True)
class WithdrawDemonstration:
    """Withdraw a demonstration of the option."""

    uuid: str = ''  # empty: the newest


@dataclass(frozen=True, slots=True)
class ListDemonstrations:
    """List the demonstrations of an option, including withdrawn ones."""

    option_name: str = ''  # empty: the current option


@dataclass(frozen=True, slots=True)
class ChangeOption:
    """Rename or delete an option."""

    name: str
    new_name: str = ''  # empty: delete the option


LessonRequest = (
    OpenSession
    | DefineOption
    | AnswerQuestion
    | BeginDemonstration
    | EndDemonstration
    | AddDemonstrations
    | WithdrawDemonstration
    | ListDemonstrations
    | ChangeOption
)


@dataclass(frozen=True, slots=True)
class Drive:
    """Take one primitive action as a person: an ActionCommand, which the game answers."""

    action: str  # empty: stop the action under way, and take control
    episode: int  # of the last state that the person saw
    step: int


@dataclass(frozen=True, slots=True)
class SetControl:
    """Take control of the game for a person, or return it to the machine."""

    hold: bool


@dataclass(frozen=True, slots=True)
class SetPace:
    """Pause, resume or single-step the machine, or change its pace."""

    step_period: float  # s
    paused: bool
    steps: int = 0  # if paused: number of steps to take first


@dataclass(frozen=True, slots=True)
class NewEpisode:
    """Begin an episode from a start state of the task."""

    seed: int


@dataclass(frozen=True, slots=True)
class ListOptions:
    """List the options of a participant."""

    participant: str


@dataclass(frozen=True, slots=True)
class SetExecution:
    """Change the execution of the running policy, effective with its next action."""

    execution: str


@dataclass(frozen=True, slots=True)
class RunOption:
    """Run a taught option from the current state."""

    option_name: str
    participant: str


@dataclass(frozen=True, slots=True)
class PlanOptions:
    """Plan with an action set."""

    action_set: str
    participant: str
    seed: int
    evaluation_episodes: int = 20  # 0: no evaluation
    game_steps: int = 0  # number to sample; 0: the default
    options_sequence: int = 0  # of the LearnedOption to wait for; 0: none
    columns: tuple[str, ...] = ()  # features that the choice between options depends on


@dataclass(frozen=True, slots=True)
class PlayEpisodes:
    """Play episodes with the newest plan of an action set, or learn while the machine drives."""

    action_set: str
    participant: str
    episodes: int
    seed: int
    execution: str
    learning: str = ''  # q: Q-learning; empty: play the plan
    columns: tuple[str, ...] = ()  # of learning, as in ``PlanOptions``


@dataclass(frozen=True, slots=True)
class CancelRun:
    """Cancel the current run."""


ActionGoal = (
    RunOption | PlanOptions | PlayEpisodes
)  # action goals, which continue after acceptance
ServiceRequest = LessonRequest | SetControl | SetPace | NewEpisode | ListOptions | SetExecution
Request = ServiceRequest | Drive | ActionGoal | CancelRun


_SERVERS: Mapping[type, str] = {
    **dict.fromkeys((Drive, SetControl, SetPace, NewEpisode), 'game'),
    **dict.fromkeys((ListOptions, RunOption), 'option_server'),
    **dict.fromkeys((PlanOptions, PlayEpisodes, SetExecution), 'planner'),
    CancelRun: 'option_server or planner',
}


def server(kind: type) -> str:
    """Return the node that answers a type of request."""
    return _SERVERS.get(kind, 'lesson')


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer to one request; fields that do not apply are empty."""

    status: RequestStatus
    detail: str
    session: str = ''  # current session
    known_options: tuple[str, ...] = ()  # of the participant
    option_names: tuple[str, ...] = ()  # options that can be run
    resumed: bool = False
    episode: int = 0  # episode begun
    state: str = ''  # first state of the episode, in the domain's notation
    uuid: str = ''  # of the demonstration kept or withdrawn
    seed: int = 0  # random seed of the new episode; for the game only
    demonstrations: tuple[Demonstration, ...] = ()  # requested ones
    contradiction: str = ''  # description of a contradiction with an earlier demonstration
    contradicts: str = ''  # uuid of the earlier demonstration
    situation: str = ''  # the state where they differ, in the domain's notation
    unsent: tuple[Demonstration, ...] = ()  # kept or withdrawn; for the learner only

    @property
    def demonstration(self) -> Demonstration | None:
        """The demonstration last kept or withdrawn; None: none."""
        return self.unsent[-1] if self.unsent else None

    @property
    def ok(self) -> bool:
        """Whether the request was carried out completely."""
        return self.status is RequestStatus.OK

    @property
    def carried_out(self) -> bool:
        """Whether the request was carried out; with NO_FEATURE, the questions start again."""
        return self.status in (RequestStatus.OK, RequestStatus.NO_FEATURE)


class RefusalError(Exception):
    """The lesson refuses a request; ``answer`` has the status and the reason."""

    def __init__(self, status: RequestStatus, detail: str) -> None:
        super().__init__(detail)
        self.answer = Answer(status, detail)


@dataclass(frozen=True, slots=True)
class LessonView:
    """The state of the lesson, as in LessonState."""

    phase: Phase
    participant: str = ''
    session: str = ''
    option_name: str = ''
    question_id: int = 0  # 0: none is open
    question: str = ''
    question_feature: str = ''  # empty: the question is about a run of the machine
    question_states: tuple[str, ...] = ()  # of that run
    question_compared: tuple[str, ...] = ()  # of a demonstration to compare it with
    questions_total: int = 0
    derived_features: tuple[str, ...] = ()  # formulas added as features of the participant
    chosen_features: tuple[str, ...] = ()
    earlier_features: tuple[str, ...] = ()  # before the questions were asked again
    n_demonstrations: int = 0
    n_not_here: int = 0
    last_uuid: str = ''  # of the newest demonstration; empty: none
    n_questions: int = 0  # answered questions about runs of the option
    exam_right: int = 0  # runs called right in the exam of the option
    exam_runs: int = 0
    exam_needed: int = 0  # 0: there is no exam
    exam: bool = False  # the demonstration under way is a run in the exam
    budget: int = 0
    strategy: str = ''
    method: str = ''  # learning method for the option's next demonstration
    start_state: str = ''
    episode: int = 0  # of the newest demonstration begun
    machine_steps: int = 0  # number of leading steps taken by the machine
    criteria_met: bool = False
    learned: bool = False  # criteria met and exam passed, for the current answers
    trial_games: int = 0  # played by the newest plan, to find where it gets stuck; 0: none
    stuck_options: tuple[str, ...] = ()  # options to demonstrate where that plan got stuck
    stuck_games: tuple[int, ...] = ()  # number of games for each of them
    suggested_column: str = ''  # feature that the choice between options seems to depend on
    paused: str = ''  # reason for the pause; empty: not paused
    text: str = ''


UNKNOWN = LessonView(Phase.NO_SESSION)  # before the lesson has published its state
_NO_GAME = Transition()


@dataclass(frozen=True, slots=True)
class Progress:
    """The action that a robot is carrying out, as in ActionProgress."""

    episode: int = 0
    step: int = 0
    action: str = ''  # empty: none is under way
    source: int = 0
    seconds: float = 0.0  # since it began
    feedback: str = ''
    stopped: str = ''  # why the robot cannot move; empty: it can


_AT_REST = Progress()


@dataclass(slots=True)
class World:
    """The newest data published on the graph."""

    domain: ActableDomain | None = None  # None: not received yet
    game: Transition = _NO_GAME  # episode 0: not received yet
    before: Transition | None = None  # state before the last step to ``game``
    lesson: LessonView = UNKNOWN
    summaries: Sequence[OptionSummary] = ()
    running: str = ''  # last goal of option_server: an option, or action:NAME
    execution: str = ''  # of the current or last policy run; empty: none
    progress: Progress = _AT_REST
    holder: str = ''  # publisher_id of the driving terminal; empty: none
    locked: str = ''  # why the robot is locked until a person takes control; empty: not locked
    supervisor: str = ''  # publisher_id of the terminal that supervises the machine; empty: none
    me: str = ''  # our own publisher_id
    step_period: float = 0.0  # minimum time between machine steps, s
    paused_by: str = ''  # publisher_id of the pausing terminal; empty: none
    missing: Sequence[str] = ()  # nodes that are not running
    acted: dict[tuple[str, int], str] = field(default_factory=dict)
    """The option that took each recent action, by publisher_id and sequence of the command."""
    uncovered: Sequence[tuple[str, float]] | None = None  # by the last plan; None: unknown
    since: Transition | None = None  # state from which the person has been driving
    driven: list[Transition] = field(default_factory=list)  # the person's steps since then

    @property
    def robot(self) -> bool:
        """Whether it is a robot: states cannot be chosen, since the rules are unknown."""
        return self.domain is not None and not can_simulate(self.domain)

    @property
    def in_control(self) -> bool:
        """Whether this terminal has control."""
        return bool(self.me) and self.holder == self.me

    def update_game(self, game: Transition) -> None:
        """Store the newest state of the game, and its predecessor if no step is missing."""
        now = self.game
        if game.replaces(now):
            if self.driven:
                self.driven[-1] = game
            else:
                self.since = game
        elif (game.episode, game.step) != (now.episode, now.step):
            self.before = now if game.follows(now) else None
            if self.before is None or game.action_source is not Source.PERSON:
                self.since, self.driven = game, []
            else:
                self.driven.append(game)
        self.game = game

    @property
    def last_effect(self) -> StepEffect | None:
        """The effect of the last step; None: no step yet, or the state before it is unknown."""
        domain, game, before = self.domain, self.game, self.before
        if domain is None or before is None or not game.previous_action:
            return None
        return effect_between(domain, before, game)

    def longest(self, action: str) -> float:
        """Return the maximum duration of an action, s; 0: it takes no time."""
        actions = self.domain.actions if self.domain is not None else ()
        return next((each.seconds for each in actions if each.name == action), 0.0)

    def summary_of(self, participant: str, option_name: str) -> OptionSummary | None:
        """Return the learner's summary of an option; None: not reported yet."""
        wanted = (participant, option_name)
        return next((s for s in self.summaries if (s.participant, s.option_name) == wanted), None)


def settled(request: Request, answer: Answer, world: World) -> bool:
    """
    Return whether the published state reflects a request.

    The state is published on topics, so it may arrive after the answer of a service.

    :param answer: answer to the request, which must have been carried out.
    """
    lesson, game = world.lesson, world.game
    match request:
        case SetPace(period, paused):
            return (world.step_period, bool(world.paused_by)) == (period, paused)
        case SetControl(hold):
            return world.in_control == hold
        case SetExecution(execution):
            return world.execution == execution
        case NewEpisode():
            return game.episode >= answer.episode
        case OpenSession(participant, session):
            return lesson.participant == participant and session in ('', lesson.session)
        case DefineOption(name, derived_features=derived):
            return lesson.option_name == name and {*derived} <= {*lesson.derived_features}
        case AnswerQuestion(question_id):
            taken_back = not question_id and bool(answer.uuid)  # of a verdict: opens no question
            learning = lesson.phase is Phase.LEARNING
            return lesson.question_id != question_id or learning or taken_back
        case BeginDemonstration():
            return game.episode >= answer.episode == lesson.episode
        case EndDemonstration(episode=episode):
            return lesson.phase is not Phase.DEMONSTRATING or lesson.episode != episode
        case AddDemonstrations() | WithdrawDemonstration():
            return lesson.last_uuid != answer.uuid
        case ChangeOption(name):
            return lesson.option_name != name
        case _:
            return True
