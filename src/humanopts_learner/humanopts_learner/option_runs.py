"""
Recorded runs of options, the basis of plans in a world that cannot be simulated.

A run contains the features of every state, so abstract states are formed only when a plan is made,
with the options and columns of that time. ``RunCollector`` assembles runs from the messages of the
graph, live or from a bag.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
import json
from pathlib import Path
from typing import Any
from uuid import UUID

from humanopts_env.arrays import Rows
from humanopts_env.domains.base import ActableDomain, action_index
from humanopts_env.domains.registry import parameters_json
from humanopts_env.game import check_features, Transition
from humanopts_learner.append_only_log import AppendOnlyLog
from humanopts_learner.run import RunResult, RunStatus
from humanopts_ros.limits import parse_json
import numpy as np
from pydantic import TypeAdapter

OPTION_RUNS = 'option_runs.jsonl'
MAX_STATES = 10_000  # maximum number of states kept for assembling runs
COMPLETE = tuple(
    status.name
    for status in (
        RunStatus.REACHED,
        RunStatus.EPISODE_OVER,
        RunStatus.MAX_STEPS,
        RunStatus.STOPPED_BY_PLAN,
    )
)
"""Ends of runs that are samples of their options; others were broken off from outside."""


@dataclass(frozen=True)
class OptionRun:
    """One run of an option, k steps long."""

    run_id: str
    domain: str  # name
    domain_parameters: str  # JSON
    option: str
    participant: str  # as requested; empty: the only one
    status: str  # name of a ``RunStatus``
    episode: int
    first_step: int
    features: tuple[tuple[float, ...], ...]  # (k + 1, F)
    actions: tuple[str, ...]  # (k,)
    rewards: tuple[float, ...]  # (k,)
    terminated: bool  # the task is over at its end
    random_moves: int = 0

    @property
    def rows(self) -> Rows:
        """The features, (k + 1, F)."""
        return np.array(self.features)

    def check(self, domain: ActableDomain) -> None:
        """
        Check that the run was recorded in this domain.

        :raises ValueError: the domain differs, or parts of the run disagree.
        """
        if (self.domain, self.domain_parameters) != (domain.name, parameters_json(domain)):
            raise ValueError(f'it is a run in {self.domain} {self.domain_parameters}')
        if not len(self.actions) == len(self.rewards) == len(self.features) - 1 > 0:
            raise ValueError('it does not have a state more than actions and rewards')
        for row in self.features:
            check_features(row, domain)
        for action in self.actions:
            action_index(domain, action)


_RUN = TypeAdapter(OptionRun)


class RunLog:
    """The recorded runs of a domain, kept on disk if there is a folder."""

    def __init__(self, directory: Path | None, domain: ActableDomain) -> None:
        """
        Open the folder and read its runs.

        :param directory: folder of the runs; None: they are kept in memory only.
        :raises OSError: the folder cannot be used.
        """
        self._log: AppendOnlyLog | None = None
        self.runs: list[OptionRun] = []
        self.problems: list[str] = []  # unusable parts of the file
        if directory is None:
            return
        directory.mkdir(parents=True, exist_ok=True)
        self._log = AppendOnlyLog(directory / OPTION_RUNS)

        def entry(line: str) -> OptionRun:
            run = _RUN.validate_python(parse_json(line))
            run.check(domain)
            return run

        self.runs = self._log.read(entry)
        self.problems = self._log.problems

    def add(self, run: OptionRun) -> None:
        """
        Add a run.

        :raises OSError: writing failed; the run is kept in memory only.
        """
        self.runs.append(run)
        if self._log is not None:
            self._log.append(json.dumps(asdict(run), allow_nan=False))


def uuid_of(message: Any) -> str:
    """Return the text of a UUID message, from rclpy or a bag reader."""
    return str(UUID(bytes=bytes(message.uuid)))


def result_from_message(message: Any) -> RunResult:
    """
    Decode the fields of an ``OptionResult`` that a ``RunCollector`` needs.

    :raises ValueError: the status is unknown.
    """
    known = [*RunStatus]  # in the order of their constants
    if not 1 <= message.status <= len(known):
        raise ValueError(f'its status is {message.status}')
    return RunResult(
        known[message.status - 1],
        message.detail,
        message.option_name,
        uuid_of(message.run_id),
        message.episode,
        message.first_step,
        message.step_count,
        message.random_moves,
        terminated=message.terminated,
    )


class RunCollector:
    """
    Assembles runs from the states of the game, and from the goals and results of options.

    Messages of different topics may arrive in any order. Runs of modules are ignored.
    """

    def __init__(self, domain: ActableDomain) -> None:
        self._domain = domain
        self._game = ''  # publisher_id
        self._states: dict[tuple[int, int], Transition] = {}
        self._participants: dict[str, str] = {}  # by run_id
        self._results: list[RunResult] = []  # with states that have not arrived yet

    def on_goal(self, run_id: str, participant: str) -> None:
        """Store the participant who taught the option of a run."""
        self._participants[run_id] = participant

    def on_state(self, publisher_id: str, state: Transition) -> list[OptionRun]:
        """
        Add a state of the game.

        :return: the runs that this state completes.
        """
        if publisher_id != self._game:
            self._results = [] if self._game else self._results  # drop results of an ended game
            self._game, self._states = publisher_id, {}
        here = state.episode, state.step
        if not (state.refreshed and here in self._states):  # keep the reward of the step itself
            self._states[here] = state
            if len(self._states) > MAX_STATES:
                del self._states[next(iter(self._states))]
        return self._assemble()

    def on_result(self, result: RunResult) -> list[OptionRun]:
        """Add the result of a run; return the runs that it completes."""
        if result.step_count and result.option_name:
            self._results.append(result)
        else:
            self._participants.pop(result.run_id, None)
        return self._assemble()

    def _assemble(self) -> list[OptionRun]:
        runs, waiting = [], []
        for result in self._results:
            last = result.episode, result.first_step + result.step_count
            if last not in self._states:
                waiting.append(result)
                continue
            steps = range(result.first_step, last[1] + 1)
            states = [self._states.get((result.episode, step)) for step in steps]
            if None not in states:
                runs.append(self._run(result, [each for each in states if each is not None]))
            for position in [each for each in self._states if each < last]:
                del self._states[position]
        self._results = waiting[-MAX_STATES:]
        return runs

    def _run(self, result: RunResult, states: Sequence[Transition]) -> OptionRun:
        return OptionRun(
            run_id=result.run_id,
            domain=self._domain.name,
            domain_parameters=parameters_json(self._domain),
            option=result.option_name,
            participant=self._participants.pop(result.run_id, ''),
            status=result.status.name,
            episode=result.episode,
            first_step=result.first_step,
            features=tuple(state.features for state in states),
            actions=tuple(state.previous_action for state in states[1:]),
            rewards=tuple(state.reward for state in states[1:]),
            terminated=result.terminated,
            random_moves=result.random_moves,
        )
