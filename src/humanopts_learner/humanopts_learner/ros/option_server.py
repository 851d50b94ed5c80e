"""The node ``option_server``, which runs learned options and answers queries about them."""

from array import array
from functools import partial
from itertools import chain
from pathlib import Path
import sys
from typing import Any, ClassVar

from humanopts_env.domains.base import ActableDomain, DomainError
from humanopts_env.domains.described import simulated
from humanopts_env.ros.game_subscriber import GameSubscriber
from humanopts_interfaces.action import ExecuteOption
from humanopts_interfaces.msg import AvailableOptions, OptionResult
from humanopts_interfaces.msg import LearnedOption as OptionMessage
from humanopts_interfaces.srv import ListOptions, QueryOption, RunOption
from humanopts_learner.library import no_options_text, UnknownOptionError
from humanopts_learner.option import Mode
from humanopts_learner.options.files import load_options
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_learner.ros import OPTION_SERVER
from humanopts_learner.ros.learned_options import OptionSubscriber
from humanopts_learner.ros.runner import Runner, RunRequest
from humanopts_learner.run import Run, RunStatus
from humanopts_ros.codec import uuid_from_message
from humanopts_ros.guarded_node import PATIENCE, SEEDS
from humanopts_ros.node_base import end_goal, NodeBase
from humanopts_ros.process import run_node
from humanopts_ros.qos import LATCHED
from rclpy.action.server import ServerGoalHandle

_LEARNED = 'learned_options'  # topic
_FAREWELL = 0.5  # s to answer the client of the current run on shutdown
_FEEDBACK_PERIOD = 0.05  # minimum time in s between feedback messages


class OptionServerNode(NodeBase):
    """
    Serves the options of ``learner`` and the automatic options of ``planner``.

    Until those of ``learner`` arrive, it serves option files.
    """

    drives: ClassVar[bool] = True

    def __init__(self, **options: Any) -> None:
        super().__init__(OPTION_SERVER, **options)
        self._directory = self.setting(
            'options_directory', '', 'folder of option files to serve from the start; empty: none'
        )
        modes = [mode.value for mode in Mode]
        mode = self.setting('mode', Mode.GREEDY.value, 'greedy or sampled', among=modes)
        seed = self.setting('seed', 0, 'of what the sampled mode draws', SEEDS)
        deadline = self.setting(
            'no_progress_seconds',
            5.0,
            'time without a new state after which a run ends, s',
            PATIENCE,
            on_change=self._on_deadline,
        )
        unstick = self.setting(
            'unstick',
            True,
            'whether a run that repeats itself takes one to three random moves, in a world that '
            'is restored by replay',
        )
        self._options: dict[str, list[LearnedOption]] = {}  # by topic
        self._results = self.stamped_publisher(OptionResult, 'option_results')
        self._available = self.stamped_publisher(AvailableOptions, 'available_options', LATCHED)
        game = GameSubscriber(self, self._on_domain)
        self._runner = Runner(self, game, Mode(mode), seed, deadline, unstick=unstick)
        for topic in (_LEARNED, 'automatic_options'):
            OptionSubscriber(self, topic, partial(self._on_options, topic))
        self.recorded_service(RunOption, 'run_option', self._on_run)
        self.recorded_service(ListOptions, 'list_options', self._on_list)
        self.recorded_service(QueryOption, 'query_option', self._on_query)
        self.recorded_action(
            ExecuteOption, 'execute_option', self._execute, self._on_cancel, self._accepts
        )
        self._of_goal: dict[bytes, RunRequest] = {}  # by goal id
        self._unsent: tuple[ServerGoalHandle, Run, str] | None = None  # newest progress
        self._feedback_timer = self.create_timer(
            _FEEDBACK_PERIOD, self._send_feedback, autostart=False
        )

    def _on_deadline(self, seconds: float) -> None:
        self._runner.patience = seconds

    def waits_for(self) -> str | None:
        return None if self._runner.library is not None else 'domain_info'

    def close(self) -> None:
        """End the current run, and answer its client."""
        self._runner.stop()
        self.finish(lambda: self._runner.busy, _FAREWELL)

    def _on_domain(self, domain: ActableDomain) -> None:
        self._runner.open(domain)
        if _LEARNED not in self._options and self._directory and Path(self._directory).is_dir():
            self._options[_LEARNED], problems = load_options(Path(self._directory))
            for problem in problems:
                self.get_logger().warning(str(problem))
        self._serve()

    def _on_options(
        self, topic: str, options: list[LearnedOption], message: OptionMessage
    ) -> None:
        self._options[topic] = options
        if topic == _LEARNED:
            self._runner.taught_sequence = message.sequence
        self._serve()

    def _serve(self) -> None:
        """Once the game is known, serve and publish the options that fit it; log the others."""
        for fault in self._runner.serve(chain(*self._options.values())):
            self.get_logger().warning(f'not served: {fault}')
        if (library := self._runner.library) is None:
            return
        fields, known = _listed(library.options()), self._available.newest
        if known is None or any(getattr(known, name) != fields[name] for name in fields):
            primitive = library.primitive_names
            self._available.publish(AvailableOptions(primitive_actions=primitive, **fields))
            if known is None or known.option_names != fields['option_names']:  # not just retrained
                names = ', '.join(fields['option_names']) or 'none'
                self.get_logger().info(f'available options: {names}')

    async def _on_run(
        self, request: RunOption.Request, response: RunOption.Response
    ) -> RunOption.Response:
        asked = RunRequest(request, 'run_option', request.execution_sequence)
        response.result = await self._run(asked)
        return response

    def _accepts(self, goal: ExecuteOption.Goal) -> bool:
        """Return whether a goal can run, as far as known; publish the refusal otherwise."""
        refused = self._runner.refusal(goal) if self.waits_for() is None else None
        if refused is not None:
            self._publish(refused, 'execute_option')
        return refused is None

    def _on_cancel(self, handle: ServerGoalHandle) -> None:
        """End the run once its goal has the state canceling."""
        request = self._of_goal.get(bytes(handle.goal_id.uuid))
        if request is not None and self.executor is not None:
            end = self.guard.guarded(self._runner.end)
            self.executor.create_task(end, request, RunStatus.CANCELED)

    async def _execute(self, handle: ServerGoalHandle) -> ExecuteOption.Result:
        due = self.monotonic() + _FEEDBACK_PERIOD  # shorter runs have no feedback

        def on_progress(run: Run, action: str) -> None:
            nonlocal due
            self._unsent, now = (handle, run, action), self.monotonic()
            if now >= due:
                self._send_feedback()
                due = now + _FEEDBACK_PERIOD
            elif self._feedback_timer.is_canceled():
                self._feedback_timer.reset()

        request = RunRequest(
            handle.request,
            'execute_option',
            on_progress=on_progress,
            run_id=uuid_from_message(handle.goal_id),
        )
        key = bytes(handle.goal_id.uuid)
        self._of_goal[key] = request
        try:
            result = await self._run(request)
        finally:
            del self._of_goal[key]
        if self._unsent is not None and self._unsent[0] is handle:
            self._unsent = None
        done = result.status == result.STATUS_REACHED or (  # modules have no other end
            result.status == result.STATUS_EPISODE_OVER
            and result.terminated
            and not result.option_name
        )
        end_goal(handle, done, result.status == result.STATUS_CANCELED)
        return ExecuteOption.Result(result=result)

    def _send_feedback(self) -> None:
        """Publish the newest progress, unless already published."""
        self._feedback_timer.cancel()
        if self._unsent is None:
            return
        (handle, run, action), self._unsent = self._unsent, None
        row = run.domain.feature_values(run.state)[None]
        handle.publish_feedback(
            ExecuteOption.Feedback(
                step_count=run.step_count,
                action=action,
                total_reward=run.total_reward,
                state=run.domain.encode(run.state),
                termination=float(run.acting.termination_probability(row)[0]),
                option_name=run.acting.name,
            )
        )

    async def _run(self, request: RunRequest) -> OptionResult:
        await self.provided()
        result = await self._runner.run(request)
        self._publish(result, request.via)
        return result

    def _publish(self, result: OptionResult, via: str) -> None:
        """Publish a result; log a refusal."""
        self._results.publish(result)
        if not uuid_from_message(result.run_id):
            name = result.option_name or 'a run of modules'
            self.get_logger().warning(f'{via} of {name}: {result.detail}')

    async def _on_list(
        self, request: ListOptions.Request, response: ListOptions.Response
    ) -> ListOptions.Response:
        await self.provided()
        library = self._runner.library
        if library is None:
            response.status = response.STATUS_NO_GAME
            response.detail = 'game has not announced itself'
            return response
        options = library.options(request.participant)
        response.status = response.STATUS_OK
        if request.participant and not options:
            response.status = response.STATUS_UNKNOWN_PARTICIPANT
            people = [option.participant for option in library.options()]
            response.detail = no_options_text(request.participant, people)
        for name, values in _listed(options).items():
            setattr(response, name, values)
        response.primitive_actions = library.primitive_names
        return response

    async def _on_query(
        self, request: QueryOption.Request, response: QueryOption.Response
    ) -> QueryOption.Response:
        await self.provided()
        library, current = self._runner.library, self._runner.state
        try:
            if library is None or (current is None and not request.state):
                raise DomainError('no state is given and no episode was begun')
            domain, state = library.domain, current and current.state
            option = library.resolve(request.option_name, request.participant)
            if request.state:
                domain = simulated(domain, 'a query about another state than the current one')
                state = domain.decode(request.state)
            row = domain.feature_values(state)[None]
        except (UnknownOptionError, DomainError) as error:
            response.status = response.STATUS_BAD_STATE
            if isinstance(error, UnknownOptionError):
                response.status = response.STATUS_UNKNOWN_OPTION
            response.detail = str(error)
            return response
        chances = option.action_probabilities(row)[0]
        names = [action.name for action in domain.actions]
        response.status = response.STATUS_OK
        response.can_start = bool(option.can_start(row)[0])
        response.initiation = float(option.initiation_probability(row)[0])
        response.termination = float(option.termination_probability(row)[0])
        response.actions, response.action_probabilities = names, chances.tolist()
        response.action = names[int(chances.argmax())]
        return response


def _listed(options: list[LearnedOption]) -> dict[str, Any]:
    """Return the fields of a message that lists options."""
    return {
        'option_names': [option.name for option in options],
        'participants': [option.participant for option in options],
        'n_demonstrations': array('I', [option.n_demonstrations for option in options]),
    }


main = partial(run_node, OptionServerNode, by_events=True)  # each step waits for its answer

if __name__ == '__main__':
    sys.exit(main())
