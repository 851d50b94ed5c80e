"""
Teaching from a program: one client of the lesson and of the game that is taught in.

The terminal and the simulated teacher are written on it. A program of somebody else is a coroutine
that gets a client; ``run_with_lesson`` makes the node and runs the coroutine to its end.
"""

from collections.abc import Callable, Coroutine
from typing import Any

from humanopts_env.domains.base import Domain, DomainError
from humanopts_env.game import Transition, transition_from_message
from humanopts_env.ros.convert import domain_from_info
from humanopts_interfaces import msg, srv
from humanopts_ros.environment import prepare_discovery
from humanopts_ros.node_base import NodeBase, StartError
from humanopts_ros.qos import CURRENT, DISPLAY
from humanopts_teach.lesson.requests import (
    Answer,
    Drive,
    LessonRequest,
    LessonView,
    Phase,
    RequestStatus,
    SetControl,
    shows_outcome,
)
from humanopts_teach.ros.convert import (
    answer_from_response,
    LESSON_SERVICES,
    request_to_message,
    view_from_message,
)
import rclpy
from rclpy.client import Client
from rclpy.executors import SingleThreadedExecutor
from rclpy.task import Future
from rclpy.utilities import try_shutdown

CARRIED_OUT = (RequestStatus.OK, RequestStatus.NO_FEATURE)  # with the last, all is asked again
_PATIENCE = 30.0  # s
_GIVE_BACK = 5.0  # s for game to take control back


class LessonClientError(RuntimeError):
    """A lesson cannot go on as asked; the text says why."""


class RefusedError(LessonClientError):
    """The lesson or the game refused a request; ``answer`` has the status and the reason."""

    def __init__(self, what: str, answer: Answer) -> None:
        super().__init__(f'{what} was refused: {answer.detail}')
        self.what = what
        self.answer = answer


class NoAnswerError(LessonClientError):
    """Nobody answered in time, or nothing came of it; the text says what was waited for."""


class LessonClient:
    """
    Asks and drives as a person does, and knows where lesson and game stand.

    ``domain``, ``lesson`` and ``game`` are the newest that was published; None: nothing yet.
    """

    def __init__(
        self,
        node: NodeBase,
        *,
        patience: float = _PATIENCE,
        on_news: Callable[[], None] = lambda: None,
    ) -> None:
        """
        Create the clients, publishers and subscriptions on a node.

        :param patience: longest wait for one answer or one change, s.
        :param on_news: called after ``domain``, ``lesson`` or ``game`` has changed.
        """
        self.domain: Domain[Any] | None = None
        self.lesson: LessonView | None = None
        self.game: Transition | None = None
        self._node = node
        self._patience = patience
        self._on_news = on_news
        self._driven: list[tuple[Drive, int, Future]] = []  # with its sequence; not answered yet
        self._clients: dict[type, Client] = {
            kind: node.recorded_client(*service) for kind, service in LESSON_SERVICES.items()
        }
        self._clients[SetControl] = node.recorded_client(srv.SetControl, 'set_control')
        self._action = node.stamped_publisher(msg.ActionCommand, 'action')
        for message, topic, callback, qos in (
            (msg.DomainInfo, 'domain_info', self._on_domain, CURRENT),
            (msg.GameState, 'current_state', self._on_game, CURRENT),
            (msg.LessonState, 'lesson_state', self._on_lesson, CURRENT),
            (msg.ActionRefusal, 'action_refused', self._on_refusal, DISPLAY),
        ):
            node.create_subscription(message, topic, callback, qos)

    def waits_for(self) -> str | None:
        """Return the first topic or service that is not there yet; None: all are."""
        for topic, found in (('domain_info', self.domain), ('lesson_state', self.lesson)):
            if found is None:
                return topic
        if not self._action.heard_by('game'):
            return 'game'
        clients = self._clients.values()
        return next((c.srv_name for c in clients if not c.service_is_ready()), None)

    async def ask(self, request: LessonRequest) -> Answer:
        """
        Ask the lesson, and wait until its state shows what came of it.

        :raises RefusedError: it was not carried out.
        :raises NoAnswerError: there was no answer, or the state does not show it.
        """
        answer = await self._answer(request)
        if answer.status not in CARRIED_OUT:
            raise RefusedError(self.name_of(request), answer)
        await self.until(
            lambda: self.lesson is not None and shows_outcome(self.lesson, request, answer),
            f'the lesson to show what came of {self.name_of(request)}',
        )
        if answer.episode:
            await self.until(
                lambda: self.game is not None and self.game.episode >= answer.episode,
                f'the first state of episode {answer.episode}',
            )
        return answer

    async def drive(self, action: str) -> Transition:
        """
        Take one primitive action in the current state, and return the state that it leads to.

        :raises RefusedError: game refused it.
        :raises NoAnswerError: game did not answer, or has no state yet.
        """
        if self.game is None:
            raise NoAnswerError('game has published no state yet')
        drive = Drive(action, self.game.episode, self.game.step)
        answer = await self._answer(drive)
        if not answer.ok:
            raise RefusedError(self.name_of(drive), answer)
        return self.game

    async def until_ready(self) -> bool:
        """Wait until the learner is done; False: the lesson on the option is finished."""
        await self.until(
            lambda: self.lesson is not None and self.lesson.phase is not Phase.LEARNING,
            'the learner',
        )
        return self.lesson is not None and self.lesson.phase is Phase.READY

    async def give_back(self) -> bool:
        """Let the machine drive again; False: game does not answer."""
        request = SetControl(hold=False)
        if not self.is_ready(request):
            return False
        return await self._node.waiting.until(self.send(request).done, _GIVE_BACK)

    async def until(self, condition: Callable[[], bool], what: str) -> None:
        """
        Wait for a condition; it is looked at whenever something has changed.

        :param what: what is waited for, in words.
        :raises NoAnswerError: it did not come about in time.
        """
        if not await self._node.waiting.until(condition, self._patience):
            raise NoAnswerError(f'gave up after {self._patience:g} s of waiting for {what}')

    def is_ready(self, request: LessonRequest | Drive | SetControl) -> bool:
        """Tell whether the receiver is matched: a request that is sent before would be lost."""
        if isinstance(request, Drive):
            return self._action.heard_by('game')
        return bool(self._clients[type(request)].service_is_ready())

    def send(self, request: LessonRequest | Drive | SetControl) -> Future:
        """
        Send a request without waiting; the future's result is the ``Answer``.

        An action is answered when game has left the state that it was for, or has refused it.

        :raises PublishError: the action could not be sent.
        """
        answer = Future()
        if isinstance(request, Drive):
            self._action.publish(
                msg.ActionCommand(
                    source=msg.ActionCommand.SOURCE_PERSON,
                    episode=request.episode,
                    step=request.step,
                    action=request.action,
                )
            )
            self._driven.append((request, self._action.sequence, answer))
            return answer
        if isinstance(request, SetControl):
            holder = self._node.publisher_id
            message = srv.SetControl.Request(hold=request.hold, holder_id=holder)
        else:
            message = request_to_message(request)

        def on_response(done: Future) -> None:
            try:
                answer.set_result(answer_from_response(done.result()))
            except ValueError as error:  # of a server that is none of ours
                answer.set_result(Answer(RequestStatus.REFUSED, str(error)))
            self._node.waiting.look()

        self._clients[type(request)].call_async(message).add_done_callback(on_response)
        return answer

    def name_of(self, request: LessonRequest | Drive | SetControl) -> str:
        """Return the service of a request, or the action."""
        if isinstance(request, Drive):
            return f'action {request.action}'
        return str(self._clients[type(request)].srv_name)

    async def _answer(self, request: LessonRequest | Drive | SetControl) -> Answer:
        what = self.name_of(request)
        await self.until(lambda: self.is_ready(request), f'{what} to be there')
        future = self.send(request)
        await self.until(future.done, f'an answer of {what}')
        answer: Answer = future.result()
        return answer

    def _on_domain(self, info: msg.DomainInfo) -> None:
        try:
            self.domain = domain_from_info(info)
        except DomainError as error:
            raise StartError(str(error)) from error
        self._tell()

    def _on_lesson(self, message: msg.LessonState) -> None:
        try:
            self.lesson = view_from_message(message)
        except ValueError as error:
            self._node.get_logger().error(f'lesson_state: {error}')
        else:
            self._tell()

    def _on_game(self, message: msg.GameState) -> None:
        self.game = transition_from_message(message)
        self._on_news()
        answered = Answer(RequestStatus.OK, '')
        for drive, sequence, _ in list(self._driven):
            if (self.game.episode, self.game.step) != (drive.episode, drive.step):
                self._answer_drive(sequence, answered)
        self._node.waiting.look()

    def _on_refusal(self, message: msg.ActionRefusal) -> None:
        if message.command_publisher_id == self._node.publisher_id:
            refused = Answer(RequestStatus.REFUSED, message.detail)
            self._answer_drive(message.command_sequence, refused)
            self._node.waiting.look()

    def _answer_drive(self, sequence: int, answer: Answer) -> None:
        known = [driven for driven in self._driven if driven[1] == sequence]
        self._driven = [driven for driven in self._driven if driven[1] != sequence]
        for _, _, future in known:
            future.set_result(answer)

    def _tell(self) -> None:
        self._on_news()
        self._node.waiting.look()


def run_with_lesson(
    program: Callable[[LessonClient], Coroutine[Any, Any, None]], name: str = 'program'
) -> None:
    """
    Run a program on the graph of this shell, once lesson and game are there.

    :param program: gets the client; what it raises is raised here.
    :param name: of the program's node.
    """
    prepare_discovery()
    rclpy.init()
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
