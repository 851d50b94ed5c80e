"""The command line's own node: sees that the graph is ready, and asks it for work."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import partial
import json
from pathlib import Path
import time
from typing import Any, TypeVar

from humanopts_env.domains.base import Domain
from humanopts_env.ros.game_subscriber import GameSubscriber, Observed
from humanopts_interfaces import msg
from humanopts_interfaces.action import Plan, RunPolicy
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_learner.ros.learned_options import OptionSubscriber
from humanopts_ros.limits import one_line, shown
from humanopts_ros.node_base import NodeBase, start_ros
from humanopts_ros.peers import stated_ids
from humanopts_ros.qos import ACTION, CURRENT
from humanopts_ros.senders import signer
from humanopts_teach.launching import CONDUCTOR, LaunchError, OccupiedError, RECORDER
from humanopts_teach.launching.processes import Value
from humanopts_teach.launching.restarts import NodeExit
from humanopts_teach.lesson.simulated_teacher import FINISHED
from humanopts_teach.ros.goals import Goal
from rclpy.action.client import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.utilities import try_shutdown

LESSON, PLANNER = 'lesson', 'planner'
_PATIENCE = 5.0  # s; a pause may pass, or another node is about to say or show its cause
_LEASE = 20.0  # s that readers that were killed still hold up those who write to them
_WORK_SECONDS = 600.0  # for a plan, or for episodes
_NAMES_PERIOD = 1.0  # s between looks for other processes with names of this launch
_ROUNDS = 100  # callbacks that are carried out to catch up; more than topics and statuses
_READY, _PAUSED = msg.NodeStatus.STATE_READY, msg.NodeStatus.STATE_PAUSED

T = TypeVar('T')


class GraphClient(NodeBase):
    """
    Drives a launched graph from the command line's thread.

    It knows the state of every node and the newest message of the latched topics. Every wait looks
    after the processes and has a deadline; ``watch`` is called about twenty times a second
    meanwhile: it checks the processes, and shows progress.

    :ivar starting: whether the launch is not ready yet; then another process that has the name of
        one of its nodes ends it. Nothing that comes later does.
    :ivar report: called with a line about a process that has the name of a node of the launch.
    :ivar feedback: of the action under way; None: none has come.
    """

    state: Observed | None = None
    domain: Domain[Any] | None = None
    lesson: msg.LessonState | None = None
    learning: msg.LearningStatus | None = None
    options: Sequence[LearnedOption] = ()
    newest_option = msg.LearnedOption()  # the message that completed the options
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
        self._own: dict[str, str] = {}  # node by publisher_id, of each process of this launch
        self._reported: set[str] = set()  # other processes with such a name
        self._names_at = 0.0  # when to look for these again, s
        self._ends: Counter[str] = Counter()  # of own processes, by node
        self._resent = 0  # sequence of the lesson's status from which all is in the newest bag
        self._awaited: set[str] = set()  # nodes of this launch; others may be started again
        self.feedback: Any = None
        self._record, self._bag = bool(parameters['expect_recorder']), bag
        self._watch = watch
        self._fine = time.monotonic()  # when no node was paused last, or may be for a while, s
        self._statuses = self.peers.statuses
        for kind, topic, name in (
            (msg.LessonState, 'lesson_state', 'lesson'),
            (msg.LearningStatus, 'learning_status', 'learning'),
            (msg.RecorderStatus, 'recorder_status', 'recorder'),
        ):
            self.create_subscription(kind, topic, partial(setattr, self, name), CURRENT)
        OptionSubscriber(self, 'learned_options', self._keep_options)
        game = GameSubscriber(self, partial(setattr, self, 'domain'))
        self._current_state = game.newest()
        self._plan_client = ActionClient(self, Plan, 'plan', **ACTION)
        self._policy_client = ActionClient(self, RunPolicy, 'run_policy', **ACTION)
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
        Serve the graph until ``done``.

        :param seconds: longest wait for ``done``, or for the next change of ``progress``.
        :param what: what is waited for, to complete "gave up waiting for ...".
        :param progress: anything that changes as long as the work goes on.
        :raises LaunchError: a process died, a node cannot go on, or the time is over.
        """
        deadline = time.monotonic() + seconds
        looked, last = 0.0, progress()
        while not done():
            now = time.monotonic()
            if now - looked > 0.05:
                looked = now
                if self.domain is not None:
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
        Wait until nodes and this one are ready and, if one runs, the recorder has every topic.

        :param seconds: longest wait for the next change of what is missing.
        :raises LaunchError: as ``wait``; the text says which nodes are missing.
        """
        nodes = [name.rpartition('/')[2] for name in names]
        self._awaited.update(nodes)
        try:
            self.wait(
                lambda: not self._missing(nodes),
                seconds,
                'a change of the nodes',
                lambda: self._missing(nodes),
            )
        except LaunchError as error:
            if not (missing := self._missing(nodes)):
                raise
            raise LaunchError(f'{error}; not ready: {", ".join(missing)}') from error

    def plan(
        self, action_set: str, episodes: int, seed: int, game_steps: int = 0
    ) -> msg.PlanResult:
        """
        Plan with the newest options, and evaluate the plan.

        :param episodes: to evaluate it on; 0: it is not evaluated.
        :param seed: of all random draws.
        :param game_steps: to sample from; 0: the default.
        :raises LaunchError: it refused, failed or did not answer.
        """
        goal = Plan.Goal(
            action_set=action_set,
            evaluation_episodes=episodes,
            seed=seed,
            game_steps=game_steps,
            options_sequence=self.newest_option.sequence,
        )
        result: msg.PlanResult = self._act(self._plan_client, goal, f'the {action_set} plan')
        if result.status not in (result.STATUS_CONVERGED, result.STATUS_NOT_CONVERGED):
            raise LaunchError(f'planning with {action_set} failed: {shown(result.detail)}')
        return result

    def play(
        self, action_set: str, episodes: int, seed: int, game_steps: int = 0
    ) -> msg.PolicyResult:
        """
        Play episodes through the option server.

        Where it has no plan, or not with the newest options, it plans first.

        :param game_steps: to sample that plan from; 0: the default.
        :raises LaunchError: it refused, failed or did not answer.
        """
        goal = RunPolicy.Goal(action_set=action_set, episodes=episodes, seed=seed)
        result: msg.PolicyResult = self._act(self._policy_client, goal, 'the episodes')
        if result.status == result.STATUS_NO_PLAN:
            self.plan(action_set, 0, seed, game_steps)
            result = self._act(self._policy_client, goal, 'the episodes')
        if result.status != msg.PolicyResult.STATUS_DONE:
            raise LaunchError(f'playing by the {action_set} plan failed: {shown(result.detail)}')
        return result

    def all_recorded(self) -> bool:
        """Return whether a restarted recorder has received all demonstrations."""
        lesson = self._statuses.get(LESSON)
        there = lesson is not None and lesson.sequence >= self._resent
        return not self._resent or (there and self.peers.state(LESSON) == _READY)

    def learned(self) -> list[tuple[LearnedOption, msg.OptionStatus]]:
        """Return every learned option and its status."""
        entries = self.learning.options if self.learning is not None else ()
        status = {(entry.participant, entry.option_name): entry for entry in entries}
        return [
            (option, status[option.participant, option.name])
            for option in self.options
            if (option.participant, option.name) in status
        ]

    def stay(self, check: Callable[[], None], report: Callable[[str], None]) -> None:
        """
        Serve the graph until an interrupt.

        :param check: called all the while, to look after the processes.
        :param report: called with a line when a node of the launch pauses, and when it goes on.
        :raises LaunchError: from ``check``.
        """
        paused: dict[str, str] = {}  # what was reported
        while True:
            self.take(0.05)
            check()
            self._check_names()
            for name in sorted({*self._own.values()}):
                state, text = self.peers.state(name), self._text(name)
                if state == _PAUSED and text != paused.get(name):
                    paused[name] = text
                    report(f'{self.full_name(name)} is paused: {text}')
                elif state == _READY and paused.pop(name, None) is not None:
                    report(f'{self.full_name(name)} goes on')

    def take(self, seconds: float) -> None:
        """Process one message, once there is one."""
        self.turn(self._executor, seconds)

    def catch_up(self) -> None:
        """Process the messages that arrived in the meantime."""
        for _ in range(_ROUNDS):
            self.take(0.0)

    def unrecorded(self) -> str:
        """Return why the bag is incomplete or nothing is recorded; empty: no reason is known."""
        return self._stopped() or (shown(self.lesson.paused) if self.lesson is not None else '')

    def teacher_finished(self) -> bool:
        """Return whether the simulated teacher has taught everything."""
        return self._text('simulated_teacher').startswith(FINISHED)

    def knows_learned(self, option_name: str) -> bool:
        """
        Return whether an option is finished, and all that was learned until then has come here.

        Messages of different nodes arrive in any order.
        """
        lesson, learning = self.lesson, self.learning
        if lesson is None or learning is None:
            return False
        newest = (option_name, lesson.participant, lesson.last_uuid)
        return (
            (lesson.phase, lesson.option_name) == (lesson.PHASE_FINISHED, option_name)
            and newest in [(o.option_name, o.participant, o.last_uuid) for o in learning.options]
            and learning.publisher_id == self.newest_option.publisher_id
            and learning.options_sequence <= self.newest_option.sequence
        )

    def taught_so_far(self) -> tuple[object, int]:
        """Return what changes during teaching: the newest step and learning status."""
        state, learning = self.state, self.learning
        return state, learning.sequence if learning else 0

    def _act(self, client: ActionClient, goal: Any, what: str) -> Any:
        """Send a goal, wait, and return the ``result`` field of the action's result."""
        self.wait(client.server_is_ready, 10.0, 'the planner')
        sent = Goal(client, goal, partial(setattr, self, 'feedback'))
        self.wait(sent.accepted.done, 10.0, f'the planner to accept {what}')
        if not sent.accepted.result():
            raise LaunchError(f'the planner refused {what}')
        before, result = self._ends[PLANNER], sent.result
        self.wait(lambda: result.done() or self._ends[PLANNER] != before, _WORK_SECONDS, what)
        if not result.done():
            raise LaunchError(f'the planner ended before {what}')
        return result.result()

    def retry(self, work: Callable[[], T]) -> T:
        """
        Do work, and repeat it if it fails while a node is restarted.

        :param work: raises a LaunchError where it fails.
        :raises LaunchError: it failed although every node went on, or a node is given up.
        """
        while True:
            before = self._ends.total()
            try:
                return work()
            except LaunchError:
                self._watch()  # a node may have ended just now
                if self._ends.total() == before:
                    raise
                self.wait_ready(sorted(self._awaited))

    def note_start(self, name: str, instance: str) -> None:
        """
        Note that a process of a node of this launch is about to be started.

        :param instance: suffix of its publisher_id; only that process counts as the node.
        """
        publisher_id = f'{self.full_name(name)}#{instance}'
        self._own[publisher_id] = name
        self.peers.expect(publisher_id)

    def note_end(self, end: NodeExit, instance: str) -> None:
        """
        Publish that a node ended; the next process of that name replaces it.

        :param instance: suffix of its process's publisher_id; late statuses are ignored.
        """
        self._ends[end.node] += end.again
        self._fine = time.monotonic() + _LEASE
        self.peers.forget(f'{self.full_name(end.node)}#{instance}')
        if end.node == LESSON:  # the next one sends everything
            self._resent = min(self._resent, 1)
        if end.node == RECORDER and LESSON in self._statuses:  # it pauses, and then goes on
            lesson = self._statuses[LESSON]
            self._resent = lesson.sequence + (1 if lesson.state == _PAUSED else 2)
        self.get_logger().error(end.sentence)
        self.set_status(_READY, end.sentence)

    def _keep_options(self, options: list[LearnedOption], newest: msg.LearnedOption) -> None:
        self.options, self.newest_option = options, newest

    def _text(self, name: str) -> str:
        """Return the text of a node's status."""
        return one_line(self._statuses[name].text) if name in self._statuses else ''

    def _stopped(self) -> str:
        """Return why the launch's recorder has stopped, and what is left; empty: it has not."""
        if self.peers.state(RECORDER) != _PAUSED:
            return ''
        return f'{self._text(RECORDER)}. The bag can be read: humanopts bag info {self._bag}'

    def _missing(self, names: Sequence[str]) -> list[str]:
        """Return what a launch still waits for, with the text of each node's status."""
        lacking = [name for name in names if self.peers.state(name) != _READY]
        if not self.ready:
            lacking.append(CONDUCTOR)
        missing = [
            self.full_name(name) + (f' ({text})' if (text := self._text(name)) else '')
            for name in lacking
        ]
        complete = self.recorder is not None and self.recorder.complete
        if self._record and not missing and not complete:
            missing.append('the recorder has not got every topic')
        return missing

    def _check_paused(self) -> None:
        """
        Check whether a required node is paused.

        :raises LaunchError: the recorder is, or another one is for too long.
        """
        if stopped := self._stopped():
            raise LaunchError(stopped)
        now = time.monotonic()
        paused = [name for name in self._awaited if self.peers.state(name) == _PAUSED]
        if not paused:
            self._fine = max(self._fine, now)
        elif now - self._fine > _PATIENCE:
            name = paused[0]
            raise LaunchError(f'{self.full_name(name)} cannot go on: {self._text(name)}')

    def _check_names(self) -> None:
        """
        Check for other processes with names of nodes of this launch.

        :raises OccupiedError: one has while the launch starts.
        """
        now = time.monotonic()
        if not self.starting and now < self._names_at:
            return
        self._names_at = now + _NAMES_PERIOD
        names = {*map(signer, self._own)}
        others = {each for each in stated_ids(self) if signer(each) in names} - self._own.keys()
        found = sorted({*map(signer, others)} - self._reported)
        if found and self.starting:
            raise OccupiedError(
                f'{", ".join(found)} runs already in this ROS_DOMAIN_ID and namespace; stop it, '
                'or choose another --namespace or ROS_DOMAIN_ID'
            )
        self._reported.update(found)
        for name in found:
            self.report(f'another process runs {name} in this ROS_DOMAIN_ID and namespace; end it')
