"""One demonstration under way: the episode so far, what ends it, and what it becomes."""

from dataclasses import dataclass, replace
from typing import Any
import uuid

from humanopts_env.domains.base import Domain
from humanopts_env.domains.registry import parameters_json
from humanopts_env.game import Source, Transition
from humanopts_learner.demonstrations import Demonstration, Kind
from humanopts_teach.lesson.requests import Answer, EndDemonstration, RequestStatus, Verdict

_NAMESPACE = uuid.uuid5(uuid.NAMESPACE_URL, 'humanopts:demonstration')


class Trajectory:
    """The newest episode, collected step by step from the stream of game states."""

    def __init__(self) -> None:
        self.transitions: list[Transition] = []
        self.gap = ''  # what is missing, in words; empty: nothing

    @property
    def episode(self) -> int:
        """Number of the episode, 0 before the first."""
        return self.transitions[-1].episode if self.transitions else 0

    @property
    def last_step(self) -> int:
        """Step of the newest state, -1 before the first."""
        return self.transitions[-1].step if self.transitions else -1

    def add(self, transition: Transition) -> None:
        """Append the next state; step 0 or another episode begins a new trajectory."""
        episode, step = transition.episode, transition.step
        if step == 0 or episode != self.episode:
            self.transitions, self.gap = [], ''
            if step != 0:
                self.gap = f'the first {step} steps of episode {episode} are missing'
        elif step != self.last_step + 1:
            self.gap = self.gap or (
                f'step {step} of episode {episode} came after step {self.last_step}'
            )
        self.transitions.append(transition)


@dataclass(slots=True)
class Attempt:
    """The demonstration under way."""

    episode: int
    start_state: str  # in the domain's notation
    began: float  # clock at the start, s
    seen: bool = False  # a state of the episode has arrived

    def spoilt(self, transition: Transition, trajectory: Trajectory) -> str:
        """
        Return why the demonstration cannot go on after one more state; empty: it can.

        States of earlier episodes that come before the first of this one are late, not a reset.
        """
        if transition.episode != self.episode:
            other = self.seen or transition.episode > self.episode
            return 'the game was reset by somebody else' if other else ''
        self.seen = True
        if trajectory.gap:
            return f'states of the game were lost ({trajectory.gap})'
        if transition.step == 0 and transition.state != self.start_state:
            return f'the game began in {transition.state} and not in {self.start_state}'
        if transition.action_source is Source.MACHINE:
            return 'an option or a policy moved in this episode; stop it first'
        return ''

    def refusal(self, request: EndDemonstration, trajectory: Trajectory) -> Answer | None:
        """Return why a verdict cannot be carried out now; None: it can."""
        verdict, last = request.verdict, trajectory.last_step
        if verdict is None:
            detail = 'the verdict is none of done, not here and discard'
            return Answer(RequestStatus.BAD_VERDICT, detail)
        if verdict is Verdict.DISCARD:
            return None
        here, seen = (trajectory.episode, last), (request.episode, request.step)
        if here != seen or trajectory.episode != self.episode:
            return Answer(
                RequestStatus.NOT_CURRENT,
                f'the verdict is about episode {seen[0]} step {seen[1]}, and the demonstration '
                f'is in episode {self.episode}, the game at episode {here[0]} step {here[1]}',
            )
        if verdict is Verdict.DONE and last == 0:
            detail = 'nothing was shown yet: drive first, or say not here, or discard'
            return Answer(RequestStatus.NO_STEPS, detail)
        if verdict is Verdict.NOT_HERE and last > 0:
            detail = f'{last} steps were taken, so it is not a "not here": say done, or discard'
            return Answer(RequestStatus.STEPS_TAKEN, detail)
        return None


@dataclass(frozen=True, slots=True)
class Label:
    """Who gives a demonstration, in which session, and of which option."""

    participant: str
    session: str
    option_name: str
    number: int
    chosen_features: tuple[str, ...]


def build_demonstration(
    domain: Domain[Any],
    trajectory: Trajectory,
    label: Label,
    *,
    seconds: float,
    can_start_at_end: bool,
) -> Demonstration:
    """
    Return the demonstration that the trajectory is; "not here" when it has no steps.

    Its uuid is derived from all its content but ``seconds``, so that the same lesson with the same
    seed gives the same uuids, and with them the same folds in learning.
    """
    transitions = trajectory.transitions
    steps = transitions[1:]
    draft = Demonstration(
        kind=Kind.TRAJECTORY if steps else Kind.NOT_HERE,
        uuid='',
        domain=domain.name,
        domain_parameters=parameters_json(domain),
        participant=label.participant,
        session=label.session,
        option_name=label.option_name,
        number=label.number,
        chosen_features=label.chosen_features,
        feature_names=tuple(feature.name for feature in domain.features),
        features=tuple(transition.features for transition in transitions),
        states=tuple(transition.state for transition in transitions),
        actions=tuple(step.previous_action for step in steps),
        rewards=tuple(step.reward for step in steps),
        terminated=transitions[-1].terminated,
        can_start_at_end=can_start_at_end,
    )
    named = replace(draft, uuid=str(uuid.uuid5(_NAMESPACE, draft.to_json())))
    return replace(named, seconds=seconds)
