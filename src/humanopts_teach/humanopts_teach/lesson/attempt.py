"""A demonstration in progress: the episode so far, its end, and the recorded result."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from humanopts_env.domains.base import ActableDomain
from humanopts_env.domains.registry import parameters_json
from humanopts_env.game import Source, Transition
from humanopts_learner.demonstrations import Demonstration, Kind
from humanopts_teach.lesson.requests import (
    EndDemonstration,
    RefusalError,
    RequestStatus,
    Verdict,
)

SHOWN_VERDICTS = Verdict.DONE, Verdict.NOT_HERE
EXAM_VERDICTS = Verdict.RIGHT, Verdict.WRONG


@dataclass(slots=True)
class Attempt:
    """
    A demonstration, starting with the request for its episode.

    The states of the newest episode are collected from the game's stream, even before the game has
    reported the number of the requested episode.
    """

    start_state: str  # in the domain's notation
    watch: bool = False  # the machine may move until the person moves
    exam: bool = False  # only the machine may move, and the person judges its run
    episode: int = 0  # number of the episode; 0: no answer from the game yet
    began: float = 0.0  # clock time at the start, s
    transitions: list[Transition] = field(default_factory=list)
    gap: str = ''  # description of states missing from the newest episode; empty: none
    seen: bool = False  # whether a state of the episode has arrived

    @property
    def here(self) -> tuple[int, int]:
        """Episode and step of the newest state; (0, -1) before the first."""
        newest = self.transitions[-1] if self.transitions else Transition(step=-1)
        return newest.episode, newest.step

    @property
    def machine_steps(self) -> int:
        """Number of leading steps taken by the machine."""
        steps = enumerate(self.transitions[1:])
        by_person = (at for at, step in steps if step.action_source is not Source.MACHINE)
        return next(by_person, len(self.transitions) - 1 if self.transitions else 0)

    def add(self, transition: Transition) -> None:
        """Append or refresh a state; step 0 or a different episode begins a new trajectory."""
        if self.transitions and transition.replaces(self.transitions[-1]):
            self.transitions[-1] = transition
            return
        (last_episode, last_step), step = self.here, transition.step
        if step == 0 or transition.episode != last_episode:
            self.transitions, self.gap = [], ''
            if step != 0:
                self.gap = f'the first {step} steps of episode {transition.episode} are missing'
        elif step != last_step + 1:
            self.gap = self.gap or (
                f'step {step} of episode {transition.episode} came after step {last_step}'
            )
        self.transitions.append(transition)

    def invalidated_by(self, transition: Transition) -> str:
        """
        Return why a new state ends the demonstration; empty: it continues.

        States of earlier episodes that arrive before the first state of this one are merely late.
        """
        if transition.episode != self.episode:
            other = self.seen or transition.episode > self.episode
            return 'another client reset the game' if other else ''
        self.seen = True
        if self.gap:
            return f'states of the game were lost ({self.gap})'
        moved = transition.state != self.start_state and not transition.refreshed
        if transition.step == 0 and moved:
            return f'the game began in {transition.state} instead of {self.start_state}'
        watched = self.watch and self.machine_steps == transition.step
        if self.exam and not watched:
            return 'a person moved in a run of the exam'
        if transition.action_source is Source.MACHINE and not watched:
            return 'the machine moved in this episode; stop its run first'
        return ''

    def check(self, request: EndDemonstration) -> None:
        """
        Check whether a verdict is currently possible.

        :raises RefusalError: it is not possible; the demonstration continues.
        """
        verdict, (_, last) = request.verdict, self.here
        possible = EXAM_VERDICTS if self.exam else SHOWN_VERDICTS
        if verdict not in (*possible, Verdict.DISCARD):
            choice = f'{possible[0].value}, {possible[1].value} or discard'
            known = 'unknown verdict' if verdict is None else f'not "{verdict.value}"'
            detail = f'{known}; choose {choice}'
            raise RefusalError(RequestStatus.BAD_VERDICT, detail)
        if verdict is Verdict.DISCARD:
            return
        seen = (request.episode, request.step)
        passed = verdict is Verdict.WRONG and (self.episode, 0) <= seen <= self.here
        if (self.here != seen or seen[0] != self.episode) and not passed:
            raise RefusalError(
                RequestStatus.NOT_CURRENT,
                f'the verdict is about episode {seen[0]} step {seen[1]}, but the demonstration '
                f'is episode {self.episode}, and the game is at episode {self.here[0]} '
                f'step {last}',
            )
        if verdict is Verdict.RIGHT and last == 0:
            detail = 'the machine has not moved: watch its run first, or say wrong, or discard'
            raise RefusalError(RequestStatus.NO_STEPS, detail)
        if verdict is Verdict.DONE and last == 0:
            detail = 'no step was taken: drive first, or say not here, or discard'
            raise RefusalError(RequestStatus.NO_STEPS, detail)
        count = request.count_machine_steps
        if verdict is Verdict.DONE and last == self.machine_steps and not count:
            detail = 'only the machine has moved: drive, or say that its steps count as shown'
            raise RefusalError(RequestStatus.NO_STEPS, detail)
        if verdict is Verdict.NOT_HERE and last > self.machine_steps:
            detail = (
                f'steps have been taken ({last}), so "not here" is no longer possible: '
                'say done, or discard'
            )
            raise RefusalError(RequestStatus.STEPS_TAKEN, detail)

    def shown(self, request: EndDemonstration) -> tuple[list[Transition], int]:
        """
        Return the states to record, and the number of leading steps taken by the machine.

        "Not here" has no steps. Machine steps that do not count are dropped: the demonstration
        begins where the person took over. An exam run ends at the last state that the person saw.
        """
        if request.verdict is Verdict.NOT_HERE:
            return self.transitions[:1], 0
        if self.exam:
            return self.transitions[: request.step + 1], request.step
        if not request.count_machine_steps:
            return self.transitions[self.machine_steps :], 0
        return self.transitions, self.machine_steps


def demonstration_of(
    domain: ActableDomain, shown: Sequence[Transition], **fields: Any
) -> Demonstration:
    """
    Return recorded states as a demonstration, without a uuid.

    :param shown: first state, and the steps after it; without steps: "not here".
    :param fields: other fields; ``option_name``, ``participant`` and ``session`` are required.
    """
    names, steps = tuple(feature.name for feature in domain.features), shown[1:]
    kind = Kind.TRAJECTORY if steps else Kind.NOT_HERE
    given = {'kind': kind, 'number': 0, 'chosen_features': names, **fields}
    return Demonstration(
        uuid='',
        domain=domain.name,
        domain_parameters=parameters_json(domain),
        feature_names=names,
        features=tuple(transition.features for transition in shown),
        states=tuple(transition.state for transition in shown),
        actions=tuple(step.previous_action for step in steps),
        rewards=tuple(step.reward for step in steps),
        terminated=shown[-1].terminated,
        **given,
    )
