"""
Teaching from a program: a client of the lesson and its game.

The terminal and the simulated teacher are based on it. A custom program is a coroutine that takes
a client; ``run_with_lesson`` creates the node and runs the coroutine to completion.
"""

from collections.abc import Callable, Coroutine, Mapping
from dataclasses import replace
from typing import Any

from humanopts_env.domains.base import ActableDomain
from humanopts_env.game import Transition
from humanopts_env.ros.game_subscriber import GameSubscriber, Observed
from humanopts_interfaces import msg, srv
from humanopts_ros.node_base import NodeBase, starting_ros
from humanopts_ros.publisher import PublishError
from humanopts_ros.qos import CURRENT, DISPLAY
from humanopts_ros.workarounds import prepare_discovery
from humanopts_teach.lesson.requests import (
    Answer,
    Drive,
    LessonRequest,
    LessonView,
    ListOptions,
    NewEpisode,
    Phase,
    RequestStatus,
    server,
    ServiceRequest,
    SetControl,
    SetPace,
    settled,
    UNKNOWN,
    World,
)
from humanopts_teach.ros.convert import (
    CONTROL_SERVICES,
    DRIVE,
    Endpoint,
    LESSON_SERVICES,
    LESSON_STATE,
)
import rclpy
from rclpy.client import Client
from rclpy.executors import SingleThreadedExecutor
from rclpy.task import Future
from rclpy.utilities import try_shutdown

LESSON = 'lesson'  # node name
_OK = Answer(RequestStatus.OK, '')
_LOST = Answer(
    RequestStatus.REFUSED,
    'a node was restarted meanwhile, or the lesson is in another session; check its state',
)
_PATIENCE = 30.0  # s
_GIVE_BACK = 5.0  # s, timeout for returning control to the game
_RENEWAL = 0.5  # s between heartbeats while this node holds control


class LessonClientError(RuntimeError):
    """A lesson cannot continue as requested; the message gives the reason."""


class RefusedError(LessonClientError):
    """The lesson or the game refused a request; ``answer`` contains the status and the reason."""

    def __init__(self, what: str, answer: Answer) -> None:
        super().__init__(f'{what} was refused: {answer.detail}')
        self.what = what
        self.answer = answer


class NoAnswerError(LessonClientError):
    """An answer or its effect did not arrive in time; the message names the awaited event."""


class LessonClient:
    """
    A client that teaches and drives like a person, and tracks lesson and game.

    :ivar world: latest published state.
    """

    def __init__(
        self,
        node: NodeBase,
        services: Mapping[type, Endpoint] = LESSON_SERVICES,
        *,
        patience: float = _PATIENCE,
        on_news: Callable[[], None] = lambda: None,
    ) -> None:
        """
        Create the clients, publishers and subscriptions on a node.

        :param services: available services in addition to ``set_control``.
        :param patience: maximum wait for an answer or a change, s.
        :param on_news: callback invoked when ``domain``, ``lesson`` or ``game`` has changed.
        """
        self.world = World(me=node.publisher_id)
        self._node = node
        self._patience = patience
        self._on_news = on_news
        self._driven: list[tuple[Drive, int, Future]] = []  # pending, with sequence
        self._asked: list[tuple[str, Future]] = []  # pending, with the node
        self._services = {**services, **CONTROL_SERVICES}
        self._clients: dict[type, Client] = {
            kind: node.recorded_client(service.kind, service.name)
            for kind, service in self._services.items()
        }
        self._action = node.stamped_publisher(msg.ActionCommand, 'action')
        self._renewal = node.create_timer(_RENEWAL, node.publish_status_again, autostart=False)
        self._game = GameSubscriber(node, self._on_domain)
        node.peers.on_restart.append(self._on_restart)
        self._subscriptions = [
            self._game.follow('current_state', self._on_game, CURRENT),
            node.subscribe(
                msg.LessonState, 'lesson_state', LESSON_STATE.decode, self._on_lesson, CURRENT
            ),
            self._game.follow_control(self._on_control),
            self._game.follow_refusals(self._on_refusal, DISPLAY),
        ]

    @property
    def domain(self) -> ActableDomain | None:
        """The rules of the game; None: not published yet."""
        return self.world.domain

    @property
    def lesson(self) -> LessonView | None:
        """The state of the lesson; None: not received yet."""
        return None if self.world.lesson is UNKNOWN else self.world.lesson

    @property
    def game(self) -> Transition | None:
        """The latest state of the game; None: not published yet."""
        return self.world.game if self.world.game.episode else None

    def waits_for(self) -> str | None:
        """Return the first topic or service that is not available yet; None: all are."""
        for topic, found in (('domain_info', self.domain), ('lesson_state', self.lesson)):
            if found is None:
                return topic
        if not self._action.is_matched_by(self._game.name):
            return 'game'
        clients = self._clients.values()
        return next((c.srv_name for c in clients if not c.service_is_ready()), None)

    async def ask(self, request: LessonRequest | Drive) -> Answer:
        """
        Send a request or an action, and wait until the published state shows its effect.

        :raises RefusedError: the request was not carried out, or its effect cannot be observed
            because a node was restarted or the lesson is in another session.
        :raises NoAnswerError: there was no answer, or the state does not show the effect.
        """
        what = self.name_of(request)
        await self.until(lambda: self.is_ready(request), f'{what} to be there')
        future, before = self.send(request), self._place()
        await self.until(future.done, f'an answer of {what}')
        answer: Answer = future.result()
        if not answer.carried_out:
            raise RefusedError(what, answer)

        def shown() -> bool:
            return settled(request, answer, self.world)

        what_came = f'the lesson to show what came of {what}'
        await self.until(lambda: shown() or self._place() != before, what_came)
        if not shown():
            raise RefusedError(what, _LOST)
        return answer

    async def drive(self, action: str) -> Transition:
        """
        Take one primitive action in the current state, and return the next state.

        :raises RefusedError: the game refused the action.
        :raises NoAnswerError: the game did not answer, or has no state yet.
        """
        if (game := self.game) is None:
            raise NoAnswerError('game has published no state yet')
        await self.ask(Drive(action, game.episode, game.step))
        assert self.game is not None
        return self.game

    async def until_ready(self) -> bool:
        """Wait until the learner is done; False: the option's lesson is finished."""
        await self.until(
            lambda: self.lesson is not None and self.lesson.phase is not Phase.LEARNING,
            'the learner',
        )
        return self.lesson is not None and self.lesson.phase is Phase.READY

    async def give_back(self) -> bool:
        """Return control to the machine; False: the game does not answer."""
        request = SetControl(hold=False)
        if not self.is_ready(request):
            return False
        return await self._node.waiting.until(self.send(request).done, _GIVE_BACK)

    def unsubscribe(self) -> None:
        """Stop tracking the lesson and the game; no more requests may be sent."""
        self._game.unsubscribe()
        self._renewal.cancel()
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._subscriptions.clear()

    async def until(self, condition: Callable[[], bool], what: str) -> None:
        """
        Wait for a condition; it is checked at every change.

        :param what: description of the awaited event.
        :raises NoAnswerError: the condition did not become true in time.
        """
        if not await self._node.waiting.until(condition, self._patience):
            raise NoAnswerError(f'gave up after {self._patience:g} s of waiting for {what}')

    def is_ready(self, request: ServiceRequest | Drive) -> bool:
        """Return whether the receiver is matched; a request sent earlier would be lost."""
        if isinstance(request, Drive):
            return self._action.is_matched_by(self._game.name)
        return bool(self._clients[type(request)].service_is_ready())

    def send(self, request: ServiceRequest | Drive) -> Future:
        """
        Send a request without waiting; the future's result is the ``Answer``.

        An action is answered when the game has left the action's state or has refused the action.
        """
        answer = Future()
        if isinstance(request, Drive):
            person = msg.ActionCommand.SOURCE_PERSON
            try:
                self._action.publish(DRIVE.encode(request, source=person))
            except PublishError as error:
                answer.set_result(Answer(RequestStatus.REFUSED, str(error)))
            else:
                self._driven.append((request, self._action.sequence, answer))
            return answer
        service = self._services[type(request)]
        message = service.request.encode(request)
        if isinstance(request, SetControl | SetPace):
            message.holder_id = self._node.publisher_id
        elif isinstance(request, NewEpisode):
            message.source = srv.ResetGame.Request.SOURCE_PERSON

        def on_response(done: Future) -> None:
            if answer.done():  # its server was restarted
                return
            assert service.answer is not None, 'not an action'
            try:
                found = service.answer.decode(done.result())
            except ValueError as error:
                found = Answer(RequestStatus.UNKNOWN, str(error))
            if isinstance(request, ListOptions):  # an empty list is also an answer
                found = replace(found, status=RequestStatus.OK)
            answer.set_result(found)
            self._node.waiting.check()

        self._asked = [asked for asked in self._asked if not asked[1].done()]
        self._asked.append((server(request), answer))
        self._clients[type(request)].call_async(message).add_done_callback(on_response)
        return answer

    def name_of(self, request: ServiceRequest | Drive) -> str:
        """Return the service name of a request, or the action."""
        if isinstance(request, Drive):
            return f'action {request.action}'
        return str(self._clients[type(request)].srv_name)

    def _place(self) -> tuple[object, ...]:
        """Return a key that changes if a request may have been lost: restarts and the session."""
        restarts, lesson = self._node.peers.restarts, self.world.lesson
        return restarts[self._game.name], restarts[LESSON], lesson.participant, lesson.session

    def _on_restart(self, name: str) -> None:
        """Answer pending requests that a restarted node has lost."""
        role = 'game' if name == self._game.name else name
        self._answer(lambda drive, _: role == 'game', _LOST)
        for asked, answer in self._asked:
            if asked == role and not answer.done():
                answer.set_result(_LOST)

    def _on_domain(self, domain: ActableDomain) -> None:
        self.world.domain = domain
        self._changed()

    def _on_lesson(self, lesson: LessonView) -> None:
        self.world.lesson = lesson
        self._changed()

    def _on_game(self, observed: Observed) -> None:
        game = observed.transition
        self.world.update_game(game)
        self._answer(lambda d, _: (d.episode, d.step) != (game.episode, game.step), _OK)

    def _on_control(self, control: msg.ControlState) -> None:
        """Renew control or the pause of the machine while this node holds it."""
        world = self.world
        world.holder, world.paused_by = control.holder_id, control.paused_by
        world.step_period = control.step_period
        if world.me in (world.holder, world.paused_by):
            self._node.publish_status_again()
            self._renewal.reset()
        else:
            self._renewal.cancel()
        self._changed()

    def _on_refusal(self, message: msg.ActionRefusal) -> None:
        if message.command_publisher_id == self._node.publisher_id:
            refused = Answer(RequestStatus.REFUSED, message.detail)
            self._answer(lambda _, sequence: sequence == message.command_sequence, refused)

    def _answer(self, concerns: Callable[[Drive, int], bool], answer: Answer) -> None:
        """Resolve the pending actions that an answer concerns."""
        for driven in self._driven.copy():
            drive, sequence, future = driven
            if concerns(drive, sequence):
                self._driven.remove(driven)
                future.set_result(answer)
        self._changed()

    def _changed(self) -> None:
        self._on_news()
        self._node.waiting.check()


def run_with_lesson(
    program: Callable[[LessonClient], Coroutine[Any, Any, None]], name: str = 'program'
) -> None:
    """
    Run a program on the graph of this environment when lesson and game are available.

    :param program: coroutine function that takes the client; its exceptions propagate.
    :param name: name of the program's node.
    :raises MiddlewareError: ROS cannot start with the environment's settings.
    """
    prepare_discovery()
    with starting_ros():
        rclpy.init()  # Ctrl-C ends the program
    executor = SingleThreadedExecutor()
    node = NodeBase(name)
    client = LessonClient(node)

    async def main() -> None:
        await client.until(lambda: client.waits_for() is None, 'lesson and game to be there')
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
