"""The command line's node: supervises a launched graph, and plans and plays in it."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
import json
import math
from pathlib import Path
import time
from typing import Any, TypeVar

from humanopts_env.ros.game_subscriber import Observed
from humanopts_interfaces import msg
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_learner.ros.learned_options import OptionSubscriber
from humanopts_learner.summary import OptionSummary
from humanopts_ros.guarded_node import start_ros
from humanopts_ros.limits import one_line, shown
from humanopts_ros.node_base import NodeBase
from humanopts_ros.peers import announced_ids
from humanopts_ros.process import woken_by_signals
from humanopts_ros.qos import CURRENT
from humanopts_ros.senders import signer
from humanopts_ros.waiting import drive
from humanopts_teach.launching import CONDUCTOR, LaunchError, OccupiedError, RECORDER
from humanopts_teach.launching.processes import Value
from humanopts_teach.launching.restarts import NodeExit
from humanopts_teach.lesson.requests import ActionGoal, Phase, PlanOptions, PlayEpisodes
from humanopts_teach.lesson.simulated_teacher import FINISHED
from humanopts_teach.ros.convert import ACTIONS, Endpoint
from humanopts_teach.ros.graph_client import ClientError, GraphClient, LESSON
from rclpy.exceptions import InvalidHandle
from rclpy.executors import SingleThreadedExecutor
from rclpy.utilities import try_shutdown

_PLANNING: dict[type, Endpoint] = {kind: ACTIONS[kind] for kind in (PlanOptions, PlayEpisodes)}
_ANSWER = 10.0  # s, timeout for the planner to accept a goal
_PATIENCE = 5.0  # s; a pause may be temporary, or another node may report its cause
_LEASE = 20.0  # s for which killed readers still block their writers
_WORK_SECONDS = 600.0  # timeout for a plan or for episodes
_IDLE_PERIOD = 0.5  # s, longest wait for a message or a call of ``wake``
_NAMES_PERIOD = 1.0  # s between checks for other processes with names of this launch
_ROUNDS = 100  # number of callbacks run to catch up; exceeds the number of topics and statuses
_READY, _PAUSED = msg.NodeStatus.STATE_READY, msg.NodeStatus.STATE_PAUSED

T = TypeVar('T')


class Conductor(NodeBase):
    """
    Supervises a launched graph from the command line's thread.

    It tracks the state of every node, and plans and plays through a ``GraphClient``. Every wait
    has a deadline; about twenty times per second it calls ``watch``, which checks the processes
    and shows progress.

    :ivar client: client of the graph.
    :ivar state: latest state of the game; None: not received yet.
    :ivar starting: whether the launch is still starting; during this time only, a foreign process
        with the name of one of its nodes aborts it.
    :ivar report: callback for a line about a foreign process with the name of a node.
    :ivar feedback: latest feedback of the active action; None: none.
    """

    state: Observed | None = None
    options: Sequence[LearnedOption] = ()
    newest_option = msg.LearnedOption()  # message that completed the options
    recorder: msg.RecorderStatus | None = None

    def __init__(
        self,
        namespace: str,
        parameters: Mapping[str, Value],
        bag: Path,
        *,
        watch: Callable[[], None],
    ) -> None:
        arguments = ['--ros-args', '-r', f'__ns:={namespace}', '--disable-stdout-logs']
        for name, value in parameters.items():
            arguments += ['-p', f'{name}:={json.dumps(value)}']
        start_ros(arguments)
        super().__init__(CONDUCTOR)
        self.starting = True
        self.report: Callable[[str], object] = lambda line: None
        self._launched: dict[str, str] = {}  # node by publisher_id, for processes of this launch
        self._reported: set[str] = set()  # reported foreign processes
        self._next_name_check = 0.0  # s, time of the next check for them
        self._resent_at = 0  # lesson status sequence from which the newest bag is complete
        self._awaited: set[str] = set()  # required nodes of this launch
        self.feedback: Any = None
        self._record, self._bag = bool(parameters['expect_recorder']), bag
        self._watch = watch
        self._unpaused_at = time.monotonic()  # s, last time unpaused, or end of a grace period
        self._statuses = self.peers.statuses
        self.create_subscription(
            msg.RecorderStatus, 'recorder_status', partial(setattr, self, 'recorder'), CURRENT
        )
        OptionSubscriber(self, 'learned_options', self._keep_options)
        self.client = GraphClient(self, _PLANNING, patience=_ANSWER)
        self._current_state = self.client.game_topics.newest()
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self)

    def close(self) -> None:
        """Leave the graph."""
        self.set_status(msg.NodeStatus.STATE_STOPPING)
        self.drain()
        self._executor.shutdown()
        self.destroy_node()
        try_shutdown()

    def wait(
        self,
        done: Callable[[], bool],
        seconds: float,
        what: str,
        progress: Callable[[], object] = lambda: None,
    ) -> None:
        """
        Serve the graph until ``done`` returns True.

        :param seconds: maximum wait for ``done`` or for the next change of ``progress``.
        :param what: awaited event; completes "gave up waiting for ...".
        :param progress: function with a result that changes while work continues.
        :raises LaunchError: a process died, a node cannot continue, or the wait timed out.
        """
        deadline = time.monotonic() + seconds
        checked, last = 0.0, progress()
        while not done():
            now = time.monotonic()
            if now - checked > 0.05:
                checked = now
                if self.client.world.domain is not None:
                    self.state = self._current_state.take() or self.state
                self._watch()
                self._check_names()
                self._check_paused()
            if (newest := progress()) != last:
                last, deadline = newest, now + seconds
            if now > deadline:
                raise LaunchError(f'gave up waiting for {what} after {seconds:.0f} s')
            self.take(0.05)

    def wait_ready(self, names: list[str], seconds: float = 60.0) -> None:
        """
        Wait until this and other nodes are ready and a recorder, if any, has every topic.

        :param names: names of the other nodes.
        :param seconds: maximum wait for the next change of the missing nodes.
        :raises LaunchError: as in ``wait``; the message lists the missing nodes.
        """
        nodes = [name.rpartition('/')[2] for name in names]
        self._awaited.update(nodes)
        said = ''  # what a robot's world waits for; a person may have to start the robot

        def progress() -> list[str]:
            nonlocal said
            text = self._text('world') if self.peers.state('world') != _READY else ''
            if text != said:
                said = text
                self.report(f'{self.full_name("world")} {said}' if said else 'the world is there')
            return self._missing(nodes)

        try:
            self.wait(lambda: not self._missing(nodes), seconds, 'a change of the nodes', progress)
        except LaunchError as error:
            if not (missing := self._missing(nodes)):
                raise
            raise LaunchError(f'{error}; not ready: {", ".join(missing)}') from error

    def plan(
        self, action_set: str, episodes: int, seed: int, game_steps: int = 0
    ) -> msg.PlanResult:
        """
        Plan with the latest options and evaluate the plan.

        :param episodes: number of evaluation episodes; 0: no evaluation.
        :param seed: seed of all random draws.
        :param game_steps: number of game steps to sample; 0: the default.
        :raises LaunchError: the planner refused, failed or did not respond.
        """
        sequence = self.newest_option.sequence
        goal = PlanOptions(action_set, '', seed, episodes, game_steps, sequence)
        result: msg.PlanResult = self._run(goal, f'the {action_set} plan')
        if result.status not in (result.STATUS_CONVERGED, result.STATUS_NOT_CONVERGED):
            raise LaunchError(f'planning with {action_set} failed: {shown(result.detail)}')
        return result

    def play(
        self, action_set: str, episodes: int, seed: int, game_steps: int = 0
    ) -> msg.PolicyResult:
        """
        Play episodes through the option server.

        Plans first if there is no plan with the latest options.

        :param game_steps: number of game steps to sample for that plan; 0: the default.
        :raises LaunchError: the planner refused, failed or did not respond.
        """
        goal = PlayEpisodes(action_set, '', episodes, seed, execution='')
        result: msg.PolicyResult = self._run(goal, 'the episodes')
        if result.status == result.STATUS_NO_PLAN:
            self.plan(action_set, 0, seed, game_steps)
            result = self._run(goal, 'the episodes')
        if result.status != msg.PolicyResult.STATUS_DONE:
            raise LaunchError(f'playing by the {action_set} plan failed: {shown(result.detail)}')
        return result

    def all_recorded(self) -> bool:
        """Return whether a restarted recorder has received all demonstrations."""
        lesson = self._statuses.get(LESSON)
        complete = lesson is not None and lesson.sequence >= self._resent_at
        return not self._resent_at or (complete and self.peers.state(LESSON) == _READY)

    def learned(self) -> list[tuple[LearnedOption, OptionSummary]]:
        """Return all learned options with their summaries."""
        found = ((o, self.client.world.summary_of(o.participant, o.name)) for o in self.options)
        return [(option, summary) for option, summary in found if summary is not None]

    def run_until_interrupt(
        self, check: Callable[[], None], report: Callable[[str], None]
    ) -> None:
        """
        Serve the graph until an interrupt.

        :param check: callback invoked continuously to monitor the processes.
        :param report: callback for a line when a node of the launch pauses or resumes.
        :raises LaunchError: raised by ``check``.
        """
        paused: dict[str, str] = {}  # reported pauses
        with woken_by_signals(self.wake):
            while True:
                self.take(_IDLE_PERIOD)
                check()
                self._check_names()
                for name in sorted({*self._launched.values()}):
                    state, text = self.peers.state(name), self._text(name)
                    if state == _PAUSED and text != paused.get(name):
                        paused[name] = text
                        report(f'{self.full_name(name)} is paused: {text}')
                    elif state == _READY and paused.pop(name, None) is not None:
                        report(f'{self.full_name(name)} continues')

    def wake(self) -> None:
        """End the wait in ``take``; thread-safe."""
        with suppress(InvalidHandle):  # the executor may have just been shut down
            self._executor.wake()

    def take(self, seconds: float) -> None:
        """Wait for one message and process it."""
        self.turn(self._executor, seconds)

    def catch_up(self) -> None:
        """Process the messages that arrived in the meantime."""
        for _ in range(_ROUNDS):
            self.take(0.0)

    def unrecorded(self) -> str:
        """Return why the bag is incomplete or nothing is recorded; empty: no known reason."""
        return self._stopped() or shown(self.client.world.lesson.paused)

    def teacher_finished(self) -> bool:
        """Return whether the simulated teacher has taught everything."""
        return self._text('simulated_teacher').startswith(FINISHED)

    def knows_learned(self, option_name: str) -> bool:
        """
        Return whether an option is finished and its final learning results have arrived.

        Messages of different nodes may arrive in any order.
        """
        lesson, learning = self.client.world.lesson, self.client.learning
        summary = self.client.world.summary_of(lesson.participant, option_name)
        return (
            (lesson.phase, lesson.option_name) == (Phase.FINISHED, option_name)
            and (summary is not None and summary.last_uuid == lesson.last_uuid)
            and learning is not None
            and learning.publisher_id == self.newest_option.publisher_id
            and learning.options_sequence <= self.newest_option.sequence
        )

    def teaching_progress(self) -> tuple[object, object]:
        """Return the progress of teaching: the latest step and learning status."""
        return self.state, self.client.learning

    def _run(self, goal: ActionGoal, what: str) -> Any:
        """Run an action of the planner to its end, and return its result."""
        ended: list[Any] = []

        async def run() -> Any:
            try:
                keep = partial(setattr, self, 'feedback')
                return await self.client.run(goal, _WORK_SECONDS, keep)
            except ClientError as error:  # an executor would log it, too
                return error

        drive(run(), ended.append)
        self.wait(lambda: bool(ended), math.inf, what)
        if isinstance(ended[0], ClientError):
            raise LaunchError(f'{what}: {ended[0]}') from ended[0]
        return ended[0]

    def retry(self, work: Callable[[], T]) -> T:
        """
        Do work, and repeat it if it fails because a node was restarted.

        :param work: function that raises a LaunchError on failure.
        :raises LaunchError: the work failed without a restart, or a node cannot be restarted.
        """
        while True:
            before = self.peers.restarts.total()
            try:
                return work()
            except LaunchError:
                self._watch()  # a node may just have ended
                if self.peers.restarts.total() == before:
                    raise
                self.wait_ready(sorted(self._awaited))

    def note_start(self, name: str, instance: str) -> None:
        """
        Register a process of a node of this launch that is about to start.

        :param instance: suffix of its publisher_id; only that process is accepted as the node.
        """
        publisher_id = f'{self.full_name(name)}#{instance}'
        self._launched[publisher_id] = name
        self.peers.expect(publisher_id)

    def note_end(self, end: NodeExit, instance: str) -> None:
        """
        Publish that a node has ended; the next process with its name replaces it.

        :param instance: suffix of the process's publisher_id; its late statuses are ignored.
        """
        self._unpaused_at = time.monotonic() + _LEASE
        self.peers.forget(f'{self.full_name(end.node)}#{instance}')
        if end.node == LESSON:  # the next lesson resends everything
            self._resent_at = min(self._resent_at, 1)
        if end.node == RECORDER and LESSON in self._statuses:  # the lesson pauses, then resumes
            lesson = self._statuses[LESSON]
            self._resent_at = lesson.sequence + (1 if lesson.state == _PAUSED else 2)
        self.get_logger().error(end.sentence)
        self.set_status(_READY, end.sentence)

    def _keep_options(self, options: list[LearnedOption], newest: msg.LearnedOption) -> None:
        self.options, self.newest_option = options, newest

    def _text(self, name: str) -> str:
        """Return the status text of a node."""
        return one_line(self._statuses[name].text) if name in self._statuses else ''

    def _stopped(self) -> str:
        """Return why the recorder has stopped, and how to read the bag; empty: it has not."""
        if self.peers.state(RECORDER) != _PAUSED:
            return ''
        return f'{self._text(RECORDER)}. The bag can be read: humanopts bag info {self._bag}'

    def _missing(self, names: Sequence[str]) -> list[str]:
        """Return the missing nodes of a launch, each with its status text."""
        not_ready = [name for name in names if self.peers.state(name) != _READY]
        if not self.ready:
            not_ready.append(CONDUCTOR)
        missing = [
            self.full_name(name) + (f' ({text})' if (text := self._text(name)) else '')
            for name in not_ready
        ]
        complete = self.recorder is not None and self.recorder.complete
        if self._record and not missing and not complete:
            missing.append('the recorder still lacks some topics')
        return missing

    def _check_paused(self) -> None:
        """
        Check whether a required node is paused.

        :raises LaunchError: the recorder is paused, or another node for too long.
        """
        if stopped := self._stopped():
            raise LaunchError(stopped)
        now = time.monotonic()
        paused = [name for name in self._awaited if self.peers.state(name) == _PAUSED]
        if not paused:
            self._unpaused_at = max(self._unpaused_at, now)
        elif now - self._unpaused_at > _PATIENCE:
            name = paused[0]
            raise LaunchError(f'{self.full_name(name)} cannot continue: {self._text(name)}')

    def _check_names(self) -> None:
        """
        Check for foreign processes with names of nodes of this launch.

        :raises OccupiedError: one is found while the launch is starting.
        """
        now = time.monotonic()
        if not self.starting and now < self._next_name_check:
            return
        self._next_name_check = now + _NAMES_PERIOD
        names = {*map(signer, self._launched)}
        others = {*announced_ids(self)} - self._launched.keys()
        found = sorted(names.intersection(map(signer, others)) - self._reported)
        if found and self.starting:
            raise OccupiedError(
                f'{", ".join(found)} already runs in this ROS_DOMAIN_ID and namespace; stop it, '
                'or choose another --namespace, such as /second, or another ROS_DOMAIN_ID'
            )
        self._reported.update(found)
        for name in found:
            self.report(f'another process runs {name} in this ROS_DOMAIN_ID and namespace; end it')
