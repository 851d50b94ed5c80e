"""The base class of the nodes ``game`` and ``world``: control, pace and publishing."""

from abc import ABC, abstractmethod
from collections import deque
from functools import partial
from typing import Any, ClassVar

from humanopts_env.game import (
    Begun,
    Command,
    Control,
    Holder,
    LockStep,
    MAX_PERIOD,
    Pacing,
    Refused,
    Result,
    Source,
    Transition,
)
from humanopts_env.lease import Lease
from humanopts_env.ros.convert import (
    command_from_message,
    control_to_message,
    domain_to_info,
    refusal_to_message,
    transition_to_message,
)
from humanopts_interfaces.msg import (
    ActionCommand,
    ActionRefusal,
    ControlState,
    DomainInfo,
    GameState,
    NodeStatus,
)
from humanopts_interfaces.srv import ResetGame, SetControl, SetPace
from humanopts_ros.limits import shown
from humanopts_ros.node_base import NodeBase
from humanopts_ros.peers import node_names
from humanopts_ros.publisher import PublishError, StampedPublisher
from humanopts_ros.qos import CURRENT, LATCHED, STREAM
from humanopts_ros.senders import Role
from rclpy.parameter import Parameter

_LOG_PERIOD = 1.0  # s between log lines about episodes
_RETRY_PERIOD = 1.0  # s between attempts to publish again
_LEASE_PERIOD = 0.25  # s between checks of the leases
_SHOW_PERIOD = 0.02  # s between current states while the machine plays


class LockStepNode(NodeBase, ABC):
    """Publishes states in lock-step, and answers every command with a state or a refusal."""

    role: ClassVar[Role] = 'game'

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, **options)
        self._game = self.make_game()
        self._seed = 0  # seed of the first episode
        period = self.setting(
            'step_period',
            0.0,
            'least time between steps of the machine, s, for people who watch',
            (0.0, MAX_PERIOD),
            on_change=self._on_step_period,
        )
        current = partial(self.stamped_publisher, qos=LATCHED, repeated=True)
        self._info = current(DomainInfo, 'domain_info')
        self._stream = self.stamped_publisher(GameState, 'game_state')
        self._current = current(GameState, 'current_state')
        self._control = current(ControlState, 'control')
        self._refusals = self.stamped_publisher(ActionRefusal, 'action_refused')
        self.create_subscription(ActionCommand, 'action', self._on_action, STREAM)
        self.recorded_service(ResetGame, 'reset_game', self._on_reset)
        self.recorded_service(SetControl, 'set_control', self._on_set_control)
        self.recorded_service(SetPace, 'set_pace', self._on_set_pace)
        topics = (self._stream, self._current, self._control, self._refusals)
        self._unsent: dict[StampedPublisher[Any], deque[Any]] = {t: deque() for t in topics}
        self._pacing = Pacing(self._game, period)
        self._pace = self.create_timer(period or 1.0, self._on_pace, autostart=False)
        self.create_timer(_RETRY_PERIOD, self._retry)
        self._lease, self._pause_lease = Lease(), Lease()
        self._logged_control: Control | None = None
        self._lease_timer = self.create_timer(_LEASE_PERIOD, self._check_lease, autostart=False)
        self._show_timer = self.create_timer(_SHOW_PERIOD, self._show, autostart=False)
        self._unshown: GameState | None = None  # the newest state, if current_state is behind
        self.create_subscription(NodeStatus, 'node_status', self._on_status, CURRENT)

    def on_ready(self) -> None:
        """Publish the domain and start the first episode."""
        self._info.publish(domain_to_info(self._game.domain))
        self.send_control(self._game.control)
        self.begin_first_episode()

    def begin_first_episode(self) -> None:
        """Begin an episode if possible, and publish the state."""
        self._game.reset('', self._seed, Source.MACHINE)
        self.send_transition(self._game.transition)

    def close(self) -> None:
        """Publish the last state as the current one."""
        self._show()

    @abstractmethod
    def make_game(self) -> LockStep:
        """
        Return a game without an episode, according to the node's parameters.

        :raises StartError: a parameter is invalid.
        """

    def on_begun(self, begun: Begun) -> None:
        """Handle an action that takes time. To be overridden."""

    def _on_action(self, message: ActionCommand) -> None:
        command = command_from_message(message)
        if command.source == Source.PERSON:
            self._lease.renew(command.publisher_id)
        self.offer(command)

    def offer(self, command: Command) -> None:
        """Execute, delay or refuse a command. To be extended."""
        self._send_results(self._pacing.offer(command))
        if self._pacing.waiting is command:
            self._pace.reset()

    def _on_pace(self) -> None:
        self._pace.cancel()
        self._send_results(self._pacing.due())

    def _send_results(self, results: list[Result]) -> None:
        for result in results:
            if isinstance(result, Refused):
                self.send_refusal(result)
                continue
            if result.control is not None:
                self.send_control(result.control)
            if isinstance(result, Begun):
                self.on_begun(result)
            else:
                self.send_transition(result.transition)

    def send_refusal(self, refused: Refused) -> None:
        """Publish a refusal."""
        self._send(self._refusals, refusal_to_message(refused))

    def _on_reset(
        self, request: ResetGame.Request, response: ResetGame.Response
    ) -> ResetGame.Response:
        reply = self._game.reset(request.start_state, request.seed, request.source)
        response.status, response.detail = int(reply.status), reply.detail
        if reply.transition is not None:
            response.episode, response.state = reply.transition.episode, reply.transition.state
            self.send_transition(reply.transition)
        return response

    def _on_set_control(
        self, request: SetControl.Request, response: SetControl.Response
    ) -> SetControl.Response:
        if request.hold and not self._is_present(request.holder_id):
            response.status = response.STATUS_NOT_HOLDER
            response.detail = f'no node {shown(request.holder_id)!r} is there to hold control'
            return response
        self._lease.renew(request.holder_id)
        reply = self._game.set_control(request.hold, request.holder_id)
        response.status, response.detail = int(reply.status), reply.detail
        if reply.control is not None:
            self.send_control(reply.control)
            if request.hold:
                self._send_results(self._pacing.due())  # refuse a waiting command immediately
        return response

    def _on_set_pace(
        self, request: SetPace.Request, response: SetPace.Response
    ) -> SetPace.Response:
        if not 0.0 <= request.step_period <= MAX_PERIOD:
            response.status = response.STATUS_BAD_PERIOD
            response.detail = f'step_period is {request.step_period}, not 0 to {MAX_PERIOD} s'
        elif request.paused and not self._is_present(request.holder_id):
            response.status = response.STATUS_NOT_HOLDER
            response.detail = f'no node {shown(request.holder_id)!r} is present to pause the game'
        else:
            response.status = response.STATUS_OK
            paused_by = request.holder_id if request.paused else ''
            self._set_pace(request.step_period, paused_by, request.steps)
            self.set_parameters([Parameter('step_period', value=request.step_period)])
        return response

    def _on_step_period(self, period: float) -> None:
        """Apply the period set as a parameter; a pause continues."""
        if period != self._pacing.period:
            self._set_pace(period, self._pacing.paused_by)

    def _set_pace(self, period: float, paused_by: str, steps: int = 0) -> None:
        self._pace.timer_period_ns = int(period * 1e9) or 1
        self._pause_lease.begin(paused_by)
        results = self._pacing.set_pace(period, paused_by, steps)
        self.send_control(self._game.control)
        self._send_results(results)

    def _is_present(self, publisher_id: str) -> bool:
        """Return whether a node has published a status under this id, or is on the graph."""
        known = self._lease.knows(publisher_id)
        return known or publisher_id.partition('#')[0] in node_names(self)

    def _on_status(self, status: NodeStatus) -> None:
        """Renew the leases of a live node; end those of a stopped one."""
        ended = status.state == NodeStatus.STATE_STOPPING
        leases = self._lease, self._pause_lease
        self._release(*(lease.note_status(status.publisher_id, ended=ended) for lease in leases))

    def _check_lease(self) -> None:
        self._release(self._lease.check(), self._pause_lease.check())

    def _release(self, control: str, pause: str) -> None:
        """Release control and end a pause, each only if its reason is not empty."""
        held = self._game.control
        if control and (held.holder is Holder.PERSON or held.supervisor_id):
            self.send_control(self._game.release(control))
        if pause and self._pacing.paused_by:
            self._set_pace(self._pacing.period, '')

    def send_control(self, control: Control) -> None:
        """Publish control, and begin the lease of its holder or supervisor."""
        responsible = control.holder_id or control.supervisor_id
        if control != self._logged_control:
            self._logged_control = control
            who = f' ({responsible})' if responsible else ''
            self.get_logger().info(f'control: {control.reason}{who}')
        self._lease.begin(responsible)
        if responsible or self._pacing.paused_by:
            self._lease_timer.reset()
        else:
            self._lease_timer.cancel()
        self._send(self._control, control_to_message(control, self._pacing))

    def send_transition(self, transition: Transition) -> None:
        """Publish a state, also as the current one unless the machine plays too fast."""
        if not transition.step and not transition.refreshed:
            self.get_logger().info(
                f'episode {transition.episode} begins: {shown(transition.state)}',
                throttle_duration_sec=_LOG_PERIOD,  # plans may play hundreds of episodes a second
            )
        message = transition_to_message(transition)  # each publisher adds its own sequence
        self._send(self._stream, message)
        self._unshown = message
        if transition.action_source is not Source.MACHINE or self._show_timer.is_canceled():
            self._show()
            self._show_timer.reset()

    def _show(self) -> None:
        """Publish the newest state as the current one; stop the timer if there is none."""
        if self._unshown is None:
            self._show_timer.cancel()
        else:
            self._send(self._current, self._unshown)
            self._unshown = None

    def _send(self, publisher: StampedPublisher[Any], message: Any) -> None:
        """Publish a message after those already waiting on its topic."""
        self._unsent[publisher].append(message)
        if len(self._unsent[publisher]) == 1:
            self._push(publisher)

    def _push(self, publisher: StampedPublisher[Any]) -> None:
        """Publish the waiting messages of a topic in order; pause the game on failure."""
        waiting = self._unsent[publisher]
        try:
            while waiting:
                publisher.publish(waiting[0])
                waiting.popleft()
        except PublishError as error:
            if not self._game.paused:
                self.pause(str(error))

    def _retry(self) -> None:
        """Publish the waiting messages, and resume the game once all are published."""
        if any(self._unsent.values()):
            for publisher in self._unsent:
                self._push(publisher)
            if not any(self._unsent.values()):
                self.pause('')

    def pause(self, reason: str) -> None:
        """Refuse commands for a reason, or accept them again if it is empty."""
        self._game.paused = reason
        self.set_status(NodeStatus.STATE_PAUSED if reason else NodeStatus.STATE_READY, reason)
