"""
The client of a graph: calls its services and actions, drives its game, and tracks its state.

The terminal, the simulated teacher and the command line are based on it. A custom program is a
coroutine that takes a client; ``run_with_lesson`` creates the node and runs the coroutine to
completion.
"""

from collections.abc import Callable, Coroutine, Mapping
from dataclasses import replace
from typing import Any

from humanopts_env.domains.base import ActableDomain
from humanopts_env.game import Transition
from humanopts_env.ros.game_subscriber import GameSubscriber, Observed
from humanopts_interfaces import msg, srv
from humanopts_learner.ros.convert import summary_from_message
from humanopts_ros.codec import uuid_from_message
from humanopts_ros.guarded_node import start_ros
from humanopts_ros.node_base import NodeBase
from humanopts_ros.publisher import PublishError
from humanopts_ros.qos import ACTION, CURRENT, DISPLAY
from humanopts_teach.lesson.requests import (
    ActionGoal,
    Answer,
    Drive,
    LessonView,
    ListOptions,
    NewEpisode,
    Phase,
    Progress,
    RequestStatus,
    RunOption,
    server,
    ServiceRequest,
    SetControl,
    SetPace,
    settled,
    UNKNOWN,
    World,
)
from humanopts_teach.ros.convert import Endpoint, LESSON_STATE, PROGRESS, TEACHING
from rclpy.action.client import ActionClient
from rclpy.client import Client
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from rclpy.utilities import try_shutdown

LESSON = 'lesson'  # node name
_OK = Answer(RequestStatus.OK, '')
_LOST = Answer(
    RequestStatus.REFUSED,
    'a node was restarted meanwhile, or the lesson is in another session; check its state',
)
_REJECTED = Answer(RequestStatus.REFUSED, 'the server rejected the goal')
_PATIENCE = 30.0  # s
_RENEWAL = 0.5  # s between heartbeats while this node holds control


class ClientError(RuntimeError):
    """The graph did not carry out a request; the message gives the reason."""


class RefusedError(ClientError):
    """A node refused a request; ``answer`` contains the status and the reason."""

    def __init__(self, what: str, answer: Answer) -> None:
        super().__init__(f'{what} was refused: {answer.detail}')
        self.what = what
        self.answer = answer


class NoAnswerError(ClientError):
    """An answer or its effect did not arrive in time; the message names the awaited event."""


class Goal:
    """
    A goal sent to an action server.

    :ivar accepted: future ``Answer``: whether the server accepts the goal.
    :ivar result: future ``result`` field of the action's result; None: the server was restarted.
        Never done if the goal is rejected.
    """

    def __init__(
        self,
        client: ActionClient,
        message: Any,
        on_feedback: Callable[[Any], object],
        rejection: Callable[[], Answer],
    ) -> None:
        """
        Send the goal; the server must be matched, or the goal is lost.

        :param rejection: function that returns the answer if the goal is rejected.
        """
        self.accepted, self.result, self._rejection = Future(), Future(), rejection
        self._handle: Any = None
        sent = client.send_goal_async(
            message, feedback_callback=lambda message: on_feedback(message.feedback)
        )
        sent.add_done_callback(self._on_answer)

    def cancel(self) -> Future:
        """Cancel the accepted goal and return the future of the response."""
        response: Future = self._handle.cancel_goal_async()
        return response

    def lose(self) -> None:
        """Resolve the pending futures, because the server was restarted."""
        for future, lost in (self.accepted, _LOST), (self.result, None):
            if not future.done():
                future.set_result(lost)

    def _on_answer(self, done: Future) -> None:
        self._handle = done.result()
        if self.accepted.done():
            return
        if self._handle.accepted:
            self._handle.get_result_async().add_done_callback(self._on_result)
        self.accepted.set_result(_OK if self._handle.accepted else self._rejection())

    def _on_result(self, done: Future) -> None:
        if not self.result.done():
            self.result.set_result(done.result().result.result)


class GraphClient:
    """
    A client that sends requests, and tracks the game, the lesson and the learner.

    :ivar world: latest published state.
    :ivar learning: latest learning status; None: not received yet.
    """

    def __init__(
        self,
        node: NodeBase,
        endpoints: Mapping[type, Endpoint] = TEACHING,
        *,
        patience: float = _PATIENCE,
        on_change: Callable[[], None] = lambda: None,
    ) -> None:
        """
        Create the clients, publishers and subscriptions on a node.

        :param endpoints: by request type; a client without ``Drive`` does not follow the steps
            of the game.
        :param patience: maximum wait for an answer or a change, s.
        :param on_change: callback invoked when the published state has changed.
        """
        self.world = World(me=node.publisher_id)
        self.learning: msg.LearningStatus | None = None
        self._node = node
        self._endpoints = endpoints
        self._patience = patience
        self._on_change = on_change
        # Requests without an answer; the number is the sequence of an action command.
        self._pending: dict[Future, tuple[ServiceRequest | Drive, int]] = {}
        self._goals: list[tuple[str, Goal]] = []  # by server
        self._services: dict[type, Client] = {}
        self._actions: dict[type, ActionClient] = {}
        for kind, endpoint in endpoints.items():
            if endpoint.answer is not None:
                self._services[kind] = node.recorded_client(endpoint.kind, endpoint.name)
            elif kind is not Drive:
                self._actions[kind] = ActionClient(node, endpoint.kind, endpoint.name, **ACTION)
        self.game_topics = GameSubscriber(node, self._on_domain)
        node.peers.on_restart.append(self._on_restart)
        self._subscriptions = [
            node.subscribe(
                msg.LessonState, 'lesson_state', LESSON_STATE.decode, self._on_lesson, CURRENT
            ),
            node.create_subscription(
                msg.LearningStatus, 'learning_status', self._on_learning, CURRENT
            ),
        ]
        self._refused_run = msg.OptionResult()  # the newest
        if RunOption in endpoints:
            self._subscriptions.append(
                node.create_subscription(
                    msg.OptionResult, 'option_results', self._on_option_result, DISPLAY
                )
            )
        self._renewal = node.create_timer(_RENEWAL, node.publish_status_again, autostart=False)
        if Drive in endpoints:
            self._action = node.stamped_publisher(msg.ActionCommand, endpoints[Drive].name)
            self._subscriptions += [
                self.game_topics.follow('current_state', self._on_game, CURRENT),
                self.game_topics.follow_control(self._on_control),
                self.game_topics.follow_refusals(self._on_refusal, DISPLAY),
            ]

    def waits_for(self) -> str | None:
        """Return the first topic or service that is not available yet; None: all are."""
        if self.world.domain is None:
            return 'domain_info'
        if self.world.lesson is UNKNOWN:
            return 'lesson_state'
        absent = (kind for kind in self._endpoints if not self.is_ready(kind))
        return next((self._endpoints[kind].name for kind in absent), None)

    async def ask(self, request: ServiceRequest | Drive) -> Answer:
        """
        Send a request or an action, and wait until the published state shows its effect.

        :raises RefusedError: the request was not carried out, or its effect cannot be observed
            because a node was restarted or the lesson is in another session.
        :raises NoAnswerError: there was no answer, or the state does not show the effect.
        """
        what = await self._found(request)
        future, before = self.send(request), self._place()
        lasts = self.world.longest(request.action) if isinstance(request, Drive) else 0.0
        await self.until(future.done, f'an answer of {what}', self._patience + lasts)
        answer: Answer = future.result()
        if not answer.carried_out:
            raise RefusedError(what, answer)

        def shown() -> bool:
            return settled(request, answer, self.world)

        await self.until(lambda: shown() or self._place() != before, f'the effect of {what}')
        if not shown():
            raise RefusedError(what, _LOST)
        return answer

    async def run(
        self,
        goal: ActionGoal,
        seconds: float,
        on_feedback: Callable[[Any], object] = lambda feedback: None,
    ) -> Any:
        """
        Run an action to its end, and return its result.

        :param seconds: maximum duration.
        :param on_feedback: callback for each feedback message.
        :raises RefusedError: the server rejected the goal, or was restarted.
        :raises NoAnswerError: there was no answer, or no result in time.
        """
        what = await self._found(goal)
        sent = self.start(goal, on_feedback)
        await self.until(sent.accepted.done, f'an answer of {what}')
        answer: Answer = sent.accepted.result()
        if answer.ok:
            await self.until(sent.result.done, f'the end of {what}', seconds)
            if (result := sent.result.result()) is not None:
                return result
            answer = _LOST
        raise RefusedError(what, answer)

    async def drive(self, action: str) -> Transition:
        """
        Take one primitive action in the current state, and return the next state.

        :raises RefusedError: the game refused the action.
        :raises NoAnswerError: the game did not answer.
        """
        game = self.world.game
        await self.ask(Drive(action, game.episode, game.step))
        return self.world.game

    async def until_learned(self) -> Phase:
        """Wait until the learner is done, and return the next phase."""
        await self.until(lambda: self.world.lesson.phase is not Phase.LEARNING, 'the learner')
        return self.world.lesson.phase

    def unsubscribe(self) -> None:
        """Stop tracking the graph and renewing control; no more requests may be sent."""
        self.game_topics.unsubscribe()
        self._renewal.cancel()
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._subscriptions.clear()

    async def until(
        self, condition: Callable[[], bool], what: str, seconds: float | None = None
    ) -> None:
        """
        Wait for a condition, which is checked at every change.

        :param what: description of the awaited event.
        :param seconds: maximum wait; None: the client's patience.
        :raises NoAnswerError: the condition did not become true in time.
        """
        seconds = self._patience if seconds is None else seconds
        if not await self._node.waiting.until(condition, seconds):
            raise NoAnswerError(f'gave up after {seconds:g} s of waiting for {what}')

    def is_ready(self, kind: type) -> bool:
        """
        Return whether a receiver is matched; a request sent earlier would be lost.

        For a goal, a restarted server must also be ready: an earlier goal is answered as lost, but
        the server may still carry it out.

        :param kind: type of request.
        """
        if kind is Drive:
            return self._action.is_matched_by(self.game_topics.name)
        if kind in self._actions:
            starting = server(kind) in self._node.peers.starting
            return bool(self._actions[kind].server_is_ready()) and not starting
        return bool(self._services[kind].service_is_ready())

    def send(self, request: ServiceRequest | Drive) -> Future:
        """
        Send a request without waiting; the future's result is the ``Answer``.

        An action is answered when the game has left the action's state or has refused the action.
        """
        answer, endpoint = Future(), self._endpoints[type(request)]
        if isinstance(request, Drive):
            person = msg.ActionCommand.SOURCE_PERSON
            try:
                self._action.publish(endpoint.request.encode(request, source=person))
            except PublishError as error:
                answer.set_result(Answer(RequestStatus.REFUSED, str(error)))
            else:
                self._pending[answer] = request, self._action.sequence
            return answer
        message = endpoint.request.encode(request)
        if isinstance(request, SetControl | SetPace):
            message.holder_id = self._node.publisher_id
        elif isinstance(request, NewEpisode):
            message.source = srv.ResetGame.Request.SOURCE_PERSON

        def on_response(done: Future) -> None:
            if self._pending.pop(answer, None) is None:  # its server was restarted
                return
            assert endpoint.answer is not None, 'a service'
            try:
                found = endpoint.answer.decode(done.result())
            except ValueError as error:
                found = Answer(RequestStatus.UNKNOWN, str(error))
            if isinstance(request, ListOptions):  # an empty list is also an answer
                found = replace(found, status=RequestStatus.OK)
            answer.set_result(found)
            self._node.waiting.check()

        self._pending[answer] = request, 0
        self._services[type(request)].call_async(message).add_done_callback(on_response)
        return answer

    def start(self, goal: ActionGoal, on_feedback: Callable[[Any], object]) -> Goal:
        """
        Send the goal of an action without waiting.

        :param on_feedback: callback for each feedback message.
        """
        message = self._endpoints[type(goal)].request.encode(goal)
        if isinstance(goal, RunOption):
            message.episode, message.step = self.world.game.episode, self.world.game.step
            if self.learning is not None and self.world.lesson.exam:  # run the examined version
                message.options_sequence = self.learning.options_sequence

        def rejection() -> Answer:
            refused = self._refused_run
            of_run = isinstance(goal, RunOption) and goal.option_name == refused.option_name
            return Answer(RequestStatus.REFUSED, refused.detail) if of_run else _REJECTED

        sent = Goal(self._actions[type(goal)], message, on_feedback, rejection)
        self._goals = [known for known in self._goals if not known[1].result.done()]
        self._goals.append((server(type(goal)), sent))
        return sent

    async def _found(self, request: ServiceRequest | Drive | ActionGoal) -> str:
        """Wait for the receiver of a request, and return a description of the request."""
        name = self._endpoints[type(request)].name
        what = f'{name} {request.action}' if isinstance(request, Drive) else name
        await self.until(lambda: self.is_ready(type(request)), f'{what} to be available')
        return what

    def _place(self) -> tuple[object, ...]:
        """Return a key of restarts and session; if it changes, a request may have been lost."""
        restarts, lesson = self._node.peers.restarts, self.world.lesson
        return (
            restarts[self.game_topics.name],
            restarts[LESSON],
            lesson.participant,
            lesson.session,
        )

    def _on_restart(self, name: str) -> None:
        """Answer pending requests that a restarted node has lost."""
        role = 'game' if name == self.game_topics.name else name
        for served_by, goal in self._goals:
            if served_by == role:
                goal.lose()
        # Do this last: a waiting coroutine may continue, and send a goal to the restarted node.
        self._answer(lambda request, _: server(type(request)) == role, _LOST)

    def _on_domain(self, domain: ActableDomain) -> None:
        self.world.domain = domain
        if self.world.robot and Drive in self._endpoints:
            kind, topic, read = msg.ActionProgress, 'action_progress', PROGRESS.decode
            progress = self.game_topics.subscribe(kind, topic, read, self._on_progress, CURRENT)
            self._subscriptions.append(progress)
        self._changed()

    def _on_lesson(self, lesson: LessonView) -> None:
        self.world.lesson = lesson
        self._changed()

    def _on_learning(self, learning: msg.LearningStatus) -> None:
        self.learning = learning
        self.world.summaries = [*map(summary_from_message, learning.options)]
        self._changed()

    def _on_option_result(self, result: msg.OptionResult) -> None:
        if not uuid_from_message(result.run_id):
            self._refused_run = result

    def _on_game(self, observed: Observed) -> None:
        game = observed.transition
        self.world.update_game(game)

        def has_left(request: ServiceRequest | Drive, sequence: int) -> bool:
            """Return whether an action has ended, not counting one that it cut short."""
            here = game.episode, game.step
            earlier = game.action_sequence < sequence
            if not isinstance(request, Drive) or (self._is_mine(game) and earlier):
                return False
            return (request.episode, request.step) != here

        self._answer(has_left, _OK)

    def _is_mine(self, game: Transition) -> bool:
        return game.action_publisher_id == self._node.publisher_id

    def _on_progress(self, progress: Progress) -> None:
        self.world.progress = progress
        self._changed()

    def _on_control(self, control: msg.ControlState) -> None:
        """Renew control or the pause of the machine while this node holds it."""
        world = self.world
        world.holder, world.paused_by = control.holder_id, control.paused_by
        locked = control.holder == control.HOLDER_LOCKED
        world.locked = control.reason if locked else ''
        world.supervisor = control.supervisor_id
        world.step_period = control.step_period
        if world.me in (world.holder, world.supervisor, world.paused_by):
            self._node.publish_status_again()
            self._renewal.reset()
        else:
            self._renewal.cancel()
        self._changed()

    def _on_refusal(self, message: msg.ActionRefusal) -> None:
        if message.command_publisher_id == self._node.publisher_id:
            refused = Answer(RequestStatus.REFUSED, message.detail)
            self._answer(lambda _, sequence: sequence == message.command_sequence, refused)

    def _answer(
        self, concerns: Callable[[ServiceRequest | Drive, int], bool], answer: Answer
    ) -> None:
        """Resolve the pending requests that an answer concerns."""
        for future, pending in [*self._pending.items()]:
            if concerns(*pending):
                del self._pending[future]
                future.set_result(answer)
        self._changed()

    def _changed(self) -> None:
        self._on_change()
        self._node.waiting.check()


def run_with_lesson(
    program: Callable[[GraphClient], Coroutine[Any, Any, None]], name: str = 'program'
) -> None:
    """
    Run a program on the graph of this environment when lesson and game are available.

    :param program: coroutine function that takes the client; its exceptions propagate.
    :param name: name of the program's node.
    :raises MiddlewareError: ROS cannot start with the environment's settings.
    """
    start_ros(signals=SignalHandlerOptions.ALL)  # Ctrl-C ends the program
    executor = SingleThreadedExecutor()
    node = NodeBase(name)
    client = GraphClient(node)

    async def main() -> None:
        await client.until(lambda: client.waits_for() is None, 'the lesson and the game')
        await program(client)

    try:
        executor.add_node(node)
        task = executor.create_task(main)
        executor.spin_until_future_complete(task)
        task.result()
    finally:
        executor.shutdown()
        node.destroy_node()
        try_shutdown()
