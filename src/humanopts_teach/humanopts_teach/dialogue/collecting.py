"""One demonstration under way: what may still happen to it, and what it becomes."""

from dataclasses import dataclass, replace
from typing import Any
import uuid

from humanopts_env.domains.base import Domain
from humanopts_env.domains.registry import parameters_json
from humanopts_env.game import Source, Transition
from humanopts_learner.demonstrations import Demonstration, Kind
from humanopts_teach.demos.trace import Trace
from humanopts_teach.dialogue.answers import Answer, Status, Verdict

_NAMESPACE = uuid.uuid5(uuid.NAMESPACE_URL, 'humanopts:demonstration')


@dataclass(slots=True)
class Attempt:
    """The demonstration under way."""

    episode: int
    start_state: str  # in the domain's notation
    began: float  # clock at the start, s
    seen: bool = False  # a state of the episode has arrived

    def spoilt(self, moment: Transition, trace: Trace) -> str:
        """
        Say why the demonstration cannot go on after one more state; empty: it can.

        States of earlier episodes that come before the first of this one are late, not a reset.
        """
        if moment.episode != self.episode:
            other = self.seen or moment.episode > self.episode
            return 'the game was reset by somebody else' if other else ''
        self.seen = True
        if trace.broken:
            return f'states of the game were lost ({trace.broken})'
        if moment.step == 0 and moment.state != self.start_state:
            return f'the game began in {moment.state} and not in {self.start_state}'
        if moment.action_source is Source.MACHINE:
            return 'an option or a policy moved in this episode; stop it first'
        return ''


def objection(
    trace: Trace, verdict: Verdict | None, wanted: tuple[int, int], attempt: Attempt
) -> Answer | None:
    """
    Say why a verdict cannot be carried out now; None: it can.

    :param verdict: None: the request named none that exists.
    :param wanted: episode and step that the person saw last.
    """
    if verdict is None:
        return Answer(Status.BAD_VERDICT, 'the verdict is none of done, not here and discard')
    if verdict is Verdict.DISCARD:
        return None
    here = (trace.episode, trace.last)
    if here != wanted or trace.episode != attempt.episode:
        return Answer(
            Status.NOT_CURRENT,
            f'the verdict is about episode {wanted[0]} step {wanted[1]}, and the demonstration '
            f'is in episode {attempt.episode}, the game at episode {here[0]} step {here[1]}',
        )
    if verdict is Verdict.DONE and trace.last == 0:
        return Answer(
            Status.NO_STEPS, 'nothing was shown yet: drive first, or say not here, or discard'
        )
    if verdict is Verdict.NOT_HERE and trace.last > 0:
        return Answer(
            Status.STEPS_TAKEN,
            f'{trace.last} steps were taken, so it is not a "not here": say done, or discard',
        )
    return None


@dataclass(frozen=True, slots=True)
class Label:
    """Whose demonstration it is, and of what."""

    participant: str
    session: str
    option_name: str
    number: int
    chosen_features: tuple[str, ...]


def build(
    domain: Domain[Any], trace: Trace, label: Label, *, seconds: float, can_start_at_end: bool
) -> Demonstration:
    """
    Return the demonstration that the trace holds; "not here" when it has no steps.

    Its uuid is derived from all its content but ``seconds``, so that the same lesson with the same
    seed gives the same uuids, and with them the same folds in learning.
    """
    moments = trace.moments
    draft = Demonstration(
        kind=Kind.TRAJECTORY if len(moments) > 1 else Kind.NOT_HERE,
        uuid='',
        domain=domain.name,
        domain_parameters=parameters_json(domain),
        participant=label.participant,
        session=label.session,
        option_name=label.option_name,
        number=label.number,
        chosen_features=label.chosen_features,
        feature_names=tuple(feature.name for feature in domain.features),
        features=tuple(moment.features for moment in moments),
        states=tuple(moment.state for moment in moments),
        actions=tuple(moment.previous_action for moment in moments[1:]),
        rewards=tuple(moment.reward for moment in moments[1:]),
        terminated=moments[-1].terminated,
        can_start_at_end=can_start_at_end,
    )
    named = replace(draft, uuid=str(uuid.uuid5(_NAMESPACE, draft.to_json())))
    return replace(named, seconds=seconds)
