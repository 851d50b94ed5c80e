"""The command line's own node: sees that the graph is ready, and asks it for work."""

from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from functools import partial
import json
import math
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
from humanopts_ros.qos import ACTION, CURRENT
from humanopts_ros.senders import signer
from humanopts_teach.launching import LaunchError, OccupiedError
from humanopts_teach.launching.launcher import CONDUCTOR
from humanopts_teach.launching.processes import RECORDER, Value
from humanopts_teach.launching.restarts import NodeExit
from humanopts_teach.launching.status import restarts_text
from humanopts_teach.lesson.simulated_teacher import FINISHED
from humanopts_teach.ros.goals import Goal
from rclpy.action.client import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.utilities import try_shutdown

LESSON = 'lesson'
_PATIENCE = 5.0  # s; a pause may pass, or another node is about to say or show its cause
_LEASE = 20.0  # s that readers that were killed still hold up those who write to them
_WORK_SECONDS = 600.0  # for a plan, or for episodes
_MAX_LINES = 20  # about paused nodes that are not of this launch ...
_LINES_PERIOD = 60.0  # s ... in this time
_ROUNDS = 100  # callbacks that are carried out to catch up; more than topics and statuses

T = TypeVar('T')


class GraphClient(NodeBase):
    """
    Drives a launched graph from the command line's thread.

    It knows every node's status and the newest message of the latched topics. Every wait looks
    after the processes and has a deadline; ``watch`` is called about twenty times a second
    meanwhile: it checks the processes, and shows progress.

    :ivar statuses: by full name of the node, of its newest process.
    :ivar starting: whether the launch is not ready yet; then another process that has the name of
        one of its nodes ends it. Nothing that comes later does.
    :ivar report: called with a line about a process that has the name of a node of the launch.
    :ivar restarts: how often each node has ended and was to be started again, by full name.
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
        self.statuses: dict[str, msg.NodeStatus] = {}
        self.starting = True
        self.report: Callable[[str], object] = lambda line: None
        self._own: dict[str, str] = {}  # publisher_id of the newest process of each of our nodes
        self._strangers: set[str] = set()  # our nodes in the name of which others publish
        self._reported: set[str] = set()  # those of them that were reported
        self.restarts: Counter[str] = Counter()
        self._ends: dict[str, list[float]] = {}  # when processes of each node ended, s
        self._gone: set[str] = set()  # publisher_ids of processes that have ended
        self._resent = 0  # sequence of the lesson's status from which all is in the newest bag
        self._awaited: set[str] = set()  # nodes of this launch; others may be started again
        self.feedback: Any = None
        self._record, self._bag = bool(parameters['expect_recorder']), bag
        self._watch = watch
        self._fine = time.monotonic()  # when no node was paused last
        self.create_subscription(msg.NodeStatus, 'node_status', self._keep_status, CURRENT)
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
                self._check_statuses()
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
        self._awaited |= set(names)
        try:
            self.wait(
                lambda: not self._missing(names),
                seconds,
                'a change of the nodes',
                lambda: self._missing(names),
            )
        except LaunchError as error:
            if not (missing := self._missing(names)):
                raise
            raise LaunchError(f'{error}; not ready: {", ".join(missing)}') from error

    def plan(
        self, action_set: str, episodes: int, seed: int, game_steps: int = 0
    ) -> msg.PlanResult:
        """
        Have the planner plan with the newest options, and judge the plan.

        :param episodes: to judge it by; 0: it is not judged.
        :param seed: of what is drawn, for the plan and to judge it.
        :param game_steps: to sample from; 0: as many as is usual.
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
        Have the planner play episodes through the option server.

        Where it has no plan, or not with the newest options, it plans first.

        :param game_steps: to sample that plan from; 0: as many as is usual.
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
        """Return whether a recorder that was started again has been sent all that was shown."""
        lesson = self.statuses.get(self.full_name(LESSON))
        return not self._resent or (
            lesson is not None
            and lesson.state == lesson.STATE_READY
            and lesson.sequence >= self._resent
        )

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
        :param report: called with a line when a node pauses, and when it goes on. Lines about
            nodes that this launch has not started, whose names anybody may claim, are limited.
        :raises LaunchError: from ``check``.
        """
        reported: dict[str, str] = {}
        lines: deque[float] = deque([-math.inf] * _MAX_LINES, _MAX_LINES)  # when they came, s
        while True:
            self.take(0.05)
            check()
            self._check_names()
            paused = self._paused()
            for name in sorted(reported.keys() | paused.keys()):
                text, status = paused.get(name), self.statuses.get(name)
                now = self.monotonic()
                limited = name not in self._own and now < lines[0] + _LINES_PERIOD
                if limited or text == reported.get(name):
                    continue  # where it is limited, the newest state is reported later
                if text is not None:
                    reported[name] = text
                    said = f'is paused: {text}'
                else:
                    del reported[name]
                    if status is None or status.state != msg.NodeStatus.STATE_READY:
                        continue
                    said = 'goes on'
                if name not in self._own:
                    lines.append(now)
                report(one_line(f'{name} {said}'))

    def take(self, seconds: float) -> None:
        """Process one message, once there is one."""
        self.turn(self._executor, seconds)

    def catch_up(self) -> None:
        """Process the messages that came while nobody served the graph."""
        for _ in range(_ROUNDS):
            self.take(0.0)

    def unrecorded(self) -> str:
        """Return why the bag is short, or nothing is recorded now; empty: neither is known."""
        return self._stopped() or (shown(self.lesson.paused) if self.lesson is not None else '')

    def teacher_finished(self) -> bool:
        """Return whether the simulated teacher has taught everything."""
        status = self.statuses.get(self.full_name('simulated_teacher'))
        return status is not None and status.text.startswith(FINISHED)

    def knows_learned(self, option_name: str) -> bool:
        """
        Return whether an option is finished, and all that was learned until then has come here.

        The topics of several nodes come in any order.
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
        planner = self.full_name('planner')
        before, result = self.restarts[planner], sent.result
        self.wait(lambda: result.done() or self.restarts[planner] != before, _WORK_SECONDS, what)
        if not result.done():
            raise LaunchError(f'the planner ended before {what}')
        return result.result()

    def retry(self, work: Callable[[], T]) -> T:
        """
        Do work that can be done again, and do so where it failed while a node ended.

        :param work: raises a LaunchError where it fails.
        :raises LaunchError: it failed although every node went on, or a node is given up.
        """
        while True:
            before = self.restarts.total()
            try:
                return work()
            except LaunchError:
                self._watch()  # a node may have ended just now
                if self.restarts.total() == before:
                    raise
                self.wait_ready(sorted(self._awaited))

    def note_start(self, name: str, instance: str) -> None:
        """
        Note that a process of a node of this launch is about to be started.

        :param instance: how its publisher_id will end; only that process speaks for the node.
        """
        node = self.full_name(name)
        self._own[node] = f'{node}#{instance}'
        self.statuses.pop(node, None)

    def note_end(self, end: NodeExit, instance: str) -> None:
        """
        Publish that a node ended; the next process of that name is then no other node.

        :param instance: how the publisher_id of its process ended; what comes late is not heard.
        """
        node = self.full_name(end.node)
        self.restarts[node] += end.again
        self._ends.setdefault(node, []).append(time.monotonic())
        self.statuses.pop(node, None)
        self._gone.add(f'{node}#{instance}')
        lesson = self.statuses.get(self.full_name(LESSON))
        if end.node == LESSON:  # the next one sends everything
            self._resent = min(self._resent, 1)
        if end.node == RECORDER and lesson is not None:  # it pauses, and then goes on
            self._resent = lesson.sequence + (1 if lesson.state == lesson.STATE_PAUSED else 2)
        self.get_logger().error(end.sentence)
        counts = {name.rpartition('/')[2]: count for name, count in self.restarts.items() if count}
        so_far = restarts_text(counts) if counts else ''
        self.set_status(msg.NodeStatus.STATE_READY, f'{end.sentence}{so_far}')

    def _keep_options(self, options: list[LearnedOption], newest: msg.LearnedOption) -> None:
        self.options, self.newest_option = options, newest

    def _keep_status(self, status: msg.NodeStatus) -> None:
        node, own = status.node, self._own.get(status.node)
        if status.publisher_id in self._gone or signer(status.publisher_id) != node:
            return
        if own is not None and status.publisher_id != own:
            self._strangers.add(node)  # another process has the name, or claims it
            return
        known = self.statuses.get(node, status)
        if status.publisher_id != known.publisher_id:  # a node of another launch of this graph
            if status.state == status.STATE_STOPPING:
                return
            if known.state == known.STATE_STOPPING:
                self._gone.add(known.publisher_id)
        status.text = one_line(status.text)
        self.statuses[node] = status

    def _stopped(self) -> str:
        """Return why the launch's recorder has stopped, and what is left; empty: it has not."""
        status = self.statuses.get(self.full_name(RECORDER))
        if status is None or status.state != msg.NodeStatus.STATE_PAUSED:
            return ''
        return f'{status.text}. The bag can be read: humanopts bag info {self._bag}'

    def _missing(self, names: list[str]) -> list[str]:
        ready = {
            name
            for name, status in self.statuses.items()
            if status.state == msg.NodeStatus.STATE_READY
        }
        missing = [self._told(name) for name in names if name not in ready]
        if not self.ready:
            missing.append(self._told(self.get_fully_qualified_name()))
        complete = self.recorder is not None and self.recorder.complete
        if self._record and not missing and not complete:
            missing.append('the recorder has not got every topic')
        return missing

    def _told(self, name: str) -> str:
        """Return the name of a node and what it says of itself."""
        text = self.statuses[name].text if name in self.statuses else ''
        return f'{name} ({text})' if text else name

    def _paused(self) -> dict[str, str]:
        """Return the nodes that are paused, and why."""
        return {
            name: status.text
            for name, status in self.statuses.items()
            if status.state == msg.NodeStatus.STATE_PAUSED
        }

    def _check_statuses(self) -> None:
        if stopped := self._stopped():
            raise LaunchError(stopped)
        mine = self._awaited | {self.full_name(RECORDER)}
        paused = {name: text for name, text in self._paused().items() if name in mine}
        now = time.monotonic()
        if not paused:
            self._fine = now
        elif now - max([self._fine, *(t[-1] + _LEASE for t in self._ends.values())]) > _PATIENCE:
            name, text = next(iter(paused.items()))
            raise LaunchError(f'{name} cannot go on: {text}')

    def _check_names(self) -> None:
        """
        Look whether other processes have names of nodes of this launch.

        :raises OccupiedError: one has while the launch starts.
        """
        suspects = set(self._own) if self.starting else self._strangers - self._reported
        if not suspects:
            return
        there = Counter(self.nodes_there())
        # One that was killed is there until the others miss it.
        since = time.monotonic() - _LEASE - _PATIENCE
        left = {name: sum(t > since for t in times) for name, times in self._ends.items()}
        found = sorted(name for name in suspects if there[name] > 1 + left.get(name, 0))
        if found and self.starting:
            raise OccupiedError(
                f'{", ".join(found)} runs already in this ROS_DOMAIN_ID and namespace; stop it, '
                'or choose another --namespace or ROS_DOMAIN_ID'
            )
        for name in found:
            self._reported.add(name)
            self.report(f'another process runs {name} in this ROS_DOMAIN_ID and namespace; end it')
