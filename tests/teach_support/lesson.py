"""A lesson with everybody around it in the hands of the test; nothing here needs ROS."""

from collections.abc import Callable, Collection, Sequence
import errno
import os
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.registry import make_domain
from humanopts_env.game import Source, Transition
from humanopts_learner.demonstrations import Demonstration, TREES
from humanopts_learner.options.checks import Check, CheckKind
from humanopts_learner.options.exam import with_verdicts
from humanopts_learner.summary import Criterion, OptionSummary
from humanopts_teach.lesson.history import OptionHistory
from humanopts_teach.lesson.lesson import Lesson
from humanopts_teach.lesson.requests import (
    Answer,
    AnswerQuestion,
    BeginDemonstration,
    DefineOption,
    EndDemonstration,
    LessonRequest,
    OpenSession,
    Phase,
    Verdict,
)
from humanopts_teach.lesson.seeded_starts import LessonRules, SeededStarts
from humanopts_teach.lesson.store import DemonstrationStore
import numpy as np
import pytest

TAXI = make_domain('taxi')
OPTION = 'go to passenger and pickup'
CHOSEN = ('taxi_row', 'taxi_col', 'passenger_row', 'passenger_col')
START = 'taxi 0,1 passenger R destination G'
OTHER = 'taxi 3,1 passenger B destination R'


class Drawn(SeededStarts):
    """Start states that do not wait for the learner."""

    def counts(self, option: OptionHistory, demonstration: Demonstration) -> bool:
        return True


class Starts(SeededStarts):
    """Start states without a learner: what is learned is set by the test."""

    known: set[str] | None = None  # uuids counted in; None: all
    more = False  # the strategy has something left to ask
    asked: Sequence[str] = ()  # states in which the option would not start, to be asked about

    def learned(self, participant: str, option_name: str, text: str) -> bool:
        return True

    def counts(self, option: OptionHistory, demonstration: Demonstration) -> bool:
        if self.known is None or not option.n_trajectories:
            return True
        return (demonstration.uuid in self.known) != demonstration.withdrawn

    def exhausted(self, option: OptionHistory, names: Collection[str] = ()) -> bool:
        return not self.more

    def check(
        self, option: OptionHistory, names: Collection[str] = (), *, every_end: bool = False
    ) -> Check | None:
        answered = {run.states[0] for run in option.judged if not run.exam}
        left = (state for state in self.asked if state not in answered)
        return next(map(not_here, left), None)

    def draw_for_exam(self, option: OptionHistory, names: Collection[str] = ()) -> str:
        return START


def not_here(state: str) -> Check:
    """Return the question whether the option should not start in a state."""
    features = tuple(TAXI.feature_values(TAXI.decode(state)).tolist())
    text = 'It would not start here. Right?'
    return Check(CheckKind.OUTSIDE, text, (state,), (features,))


def status(participant: str = 'p1', *, met: bool = False, **fields: Any) -> OptionSummary:
    """Return what the learner says of the option."""
    criteria = (Criterion('return', 0.0, 1.0, met),)
    fields = {'features': CHOSEN, 'criteria': criteria, **fields}
    return OptionSummary(OPTION, participant, **fields)


class Table:
    """A lesson with the person, the game and the learner in the hands of the test."""

    def __init__(
        self,
        store: DemonstrationStore,
        *,
        budget: int = 5,
        seed: int = 0,
        domain: Domain = TAXI,
        method: str = TREES,
        starts: type[SeededStarts] = Starts,
    ) -> None:
        self.store = store
        self.starts = starts(domain, LessonRules('random', budget, seed, method=method))
        self.time = 100.0
        self.episode = 0
        self.here: Transition | None = None
        self.lesson = Lesson(
            domain,
            store,
            self.starts,
            clock=lambda: self.time,
            today=lambda: '20260102',
        )

    def ask(self, request: LessonRequest) -> Answer:
        """Ask the lesson for something."""
        return self.lesson.carry_out(request)

    def opened(self) -> 'Table':
        """Open a session."""
        assert self.ask(OpenSession('p1', 's1')).ok
        return self

    def defined(self) -> 'Table':
        """Name the option, whose questions are now asked."""
        self.opened()
        assert self.ask(DefineOption(OPTION)).ok
        return self

    def answer_all(self, chosen: Sequence[str] = CHOSEN) -> Answer:
        """Answer yes for these features, and no for the others."""
        for feature in TAXI.features:
            view = self.lesson.view
            assert view.question_feature == feature.name
            answer = self.ask(AnswerQuestion(view.question_id, feature.name in chosen))
        return answer

    def ready(self) -> 'Table':
        """Answer the questions too."""
        self.defined()
        assert self.answer_all().ok
        return self

    def began(self, start_state: str = '', *, watch: bool = False, exam: bool = False) -> 'Table':
        """Let the game begin the episode that the lesson asks for."""
        prepared = self.ask(BeginDemonstration(start_state, watch, exam))
        assert prepared.ok, prepared
        self.episode += 1
        self.arrives(prepared.state)
        assert self.lesson.began(self.episode, prepared.state).ok
        return self

    def arrives(self, state: str) -> bool:
        """Let the game's first state of an episode arrive."""
        features = tuple(TAXI.feature_values(TAXI.decode(state)).tolist())
        self.here = Transition(self.episode, 0, state, features)
        return self.lesson.add_transition(self.here)

    def drive(self, *actions: str, source: Source = Source.PERSON) -> 'Table':
        """Take these actions, and let the lesson see each state."""
        for name in actions:
            assert self.here is not None
            action = [a.name for a in TAXI.actions].index(name)
            out = TAXI.step(TAXI.decode(self.here.state), action, np.random.default_rng(0))
            self.here = Transition(
                self.here.episode,
                self.here.step + 1,
                TAXI.encode(out.state),
                tuple(TAXI.feature_values(out.state).tolist()),
                previous_action=name,
                action_source=source,
                reward=out.reward,
                terminated=out.terminated,
            )
            self.lesson.add_transition(self.here)
        return self

    def end(
        self,
        verdict: Verdict | None = Verdict.DONE,
        again: bool = False,
        *,
        machine: bool = False,
    ) -> Answer:
        """Give a verdict on the state that is there."""
        assert self.here is not None
        seen = self.here.episode, self.here.step
        return self.ask(EndDemonstration(verdict, *seen, again, machine))

    def learned(
        self, *, met: bool = False, features: tuple[str, ...] = CHOSEN, exam: int = 0
    ) -> None:
        """Let the learner tell that everything is counted in."""
        newest = self.lesson.view.last_uuid or 'old'
        summary = status(features=features, last_uuid=newest, met=met)
        everything = [
            demo
            for demo in self.lesson.demonstrations()
            if demo.option_name == OPTION and not demo.withdrawn
        ]
        self.lesson.update_summaries([with_verdicts(summary, everything, exam)])

    def shown(self) -> 'Table':
        """Give one demonstration, learned from."""
        self.began().drive('west')
        assert self.end().ok
        self.learned()
        return self


def preparing(table: Table) -> Table:
    """Ask for an episode, which has not begun."""
    assert table.ready().ask(BeginDemonstration()).ok
    return table


def learning(table: Table) -> Table:
    """Give a demonstration, and leave the learner to it."""
    assert table.ready().began().drive('west').end().ok
    return table


def met(table: Table) -> Table:
    """Let the criteria hold after one demonstration."""
    learning(table).learned(met=True)
    return table


def spent(table: Table) -> Table:
    """Spend the budget."""
    table.ready()
    for _ in range(5):
        table.shown()
    return table


def checking(table: Table) -> Table:
    """Let the criteria hold, and a question about a run be open."""
    table.starts.asked = [OTHER]
    learning(table).learned(met=True, exam=3)
    return table


def in_exam(table: Table) -> Table:
    """Let the criteria hold, and an exam of three runs begin."""
    learning(table).learned(met=True, exam=3)
    return table


# The way from no session to each phase.
TO_PHASE: dict[Phase, Callable[[Table], Table]] = {
    Phase.NO_SESSION: lambda table: table,
    Phase.NO_OPTION: Table.opened,
    Phase.ASKING: Table.defined,
    Phase.READY: Table.ready,
    Phase.DEMONSTRATING: lambda table: table.ready().began(),
    Phase.LEARNING: learning,
    Phase.CHECKING: checking,
    Phase.EXAM: in_exam,
    Phase.FINISHED: met,
}


def fill_disk(patch: pytest.MonkeyPatch) -> None:
    """Let every write fail as on a full disk."""

    def full(handle: int) -> None:
        raise OSError(errno.ENOSPC, 'No space left on device')

    patch.setattr(os, 'fsync', full)
