"""How the terminal's requests reach the graph, and how its answers read."""

import time
from typing import Any

from humanopts_env.game import Transition
from humanopts_interfaces import action as actions
from humanopts_interfaces import srv
from humanopts_interfaces.msg import OptionResult, PlanResult
from humanopts_ros.node_base import NodeBase
from humanopts_ros.publisher import PublishError
from humanopts_teach.lesson.requests import (
    Answer,
    DefineOption,
    Drive,
    RequestStatus,
    WithdrawDemonstration,
)
from humanopts_teach.ros.lesson_client import CARRIED_OUT, LessonClient
from humanopts_teach.terminal import requests as ask
from humanopts_teach.terminal.app import App
from rclpy.action.client import ActionClient
from rclpy.client import Client
from rclpy.task import Future

_SERVICES = {  # besides those of LessonClient
    ask.NewEpisode: (srv.ResetGame, 'reset_game'),
    ask.ListOptions: (srv.ListOptions, 'list_options'),
    ask.SetExecution: (srv.SetExecution, 'set_execution'),
}
_ACTIONS = {
    ask.RunOption: (actions.ExecuteOption, 'execute_option'),
    ask.PlanOptions: (actions.Plan, 'plan'),
    ask.PlayEpisodes: (actions.RunPolicy, 'run_policy'),
}
_WELL = ('REACHED', 'EPISODE_OVER', 'CONVERGED', 'NOT_CONVERGED', 'DONE')
_PAUSED = 'Not now: the lesson is paused; the top of the screen says why.'
_PLAN_EPISODES = 20  # start states that a plan is judged from


class Calls:
    """Sends one request after the other, and hands the answers to the app; never waits."""

    def __init__(self, node: NodeBase, client: LessonClient, app: App) -> None:
        self._app = app
        self._client = client
        self._services: dict[type, Client] = {
            kind: node.recorded_client(*service) for kind, service in _SERVICES.items()
        }
        self._actions = {kind: ActionClient(node, *spec) for kind, spec in _ACTIONS.items()}
        self._held: ask.Request | None = None  # its server is not there yet
        self._handle: Any = None  # of the run under way

    def send(self, request: ask.Request | None) -> None:
        """Send a request, or the one that still waits for its server."""
        request = request or self._held
        self._held = None
        if request is None or request is not self._app.waits_for:
            return
        if isinstance(request, ask.CancelRun):
            if self._handle is not None:
                self._handle.cancel_goal_async()
            self._reply(ask.Reply(request, ok=True))
        elif not self._ready(request):
            self._held = request
        elif isinstance(request, ask.Run):
            self._start(request)
        else:
            try:
                self._call(request).add_done_callback(lambda done: self._answered(request, done))
            except PublishError as error:
                self._reply(ask.Reply(request, ok=False, text=str(error)))

    def part(self, request: ask.Request) -> Future | None:
        """Send one of the last requests; None: nobody is there to answer it."""
        if isinstance(request, ask.CancelRun):
            return self._handle.cancel_goal_async() if self._handle is not None else None
        return self._call(request) if self._ready(request) else None

    def check_server(self) -> None:
        """End the run when its server is gone."""
        run = self._app.run
        if run is not None and not self._actions[type(run)].server_is_ready():
            self._app.lost_server()

    def _ready(self, request: ask.Request) -> bool:
        """Tell whether the server is matched: a request that is sent before would be lost."""
        if isinstance(request, ask.Run):
            return bool(self._actions[type(request)].server_is_ready())
        if isinstance(request, ask.NewEpisode | ask.ListOptions | ask.SetExecution):
            return bool(self._services[type(request)].service_is_ready())
        assert not isinstance(request, ask.CancelRun), 'it goes to the run under way'
        return self._client.is_ready(request)

    def _reply(self, reply: ask.Reply) -> None:
        self._app.replied(reply, time.monotonic())

    def _call(self, request: ask.Request) -> Future:
        """
        Send a request; the future's result is an ``Answer``, or the response of a service.

        :raises PublishError: an action could not be sent.
        """
        message: Any
        assert not isinstance(request, ask.CancelRun | ask.Run), 'they are no calls'
        match request:
            case ask.NewEpisode(seed):
                source = srv.ResetGame.Request.SOURCE_PERSON
                message = srv.ResetGame.Request(source=source, seed=seed)
            case ask.ListOptions(participant):
                message = srv.ListOptions.Request(participant=participant)
            case ask.SetExecution(execution):
                message = srv.SetExecution.Request(execution=execution)
            case _:
                return self._client.send(request)
        return self._services[type(request)].call_async(message)

    def _answered(self, request: ask.Request, done: Future) -> None:
        """Hand the answer to the app, in the words that the person reads."""
        found: Any = done.result()
        if isinstance(found, Answer):
            self._reply(_lesson_reply(request, found))
        elif isinstance(request, ask.ListOptions):
            self._reply(ask.Reply(request, ok=True, names=tuple(found.option_names)))
        else:
            ok = found.status == type(found).STATUS_OK
            answer = Answer(
                RequestStatus.OK if ok else RequestStatus.REFUSED,
                found.detail,
                episode=getattr(found, 'episode', 0),
            )
            text = '' if ok else found.detail
            self._reply(ask.Reply(request, ok=ok, text=text, answer=answer))

    def _goal(self, run: ask.Run) -> Any:
        match run:
            case ask.RunOption(name, participant):
                game = self._app.world.game or Transition()
                return actions.ExecuteOption.Goal(
                    option_name=name,
                    participant=participant,
                    episode=game.episode,
                    step=game.step,
                )
            case ask.PlanOptions(action_set, participant, seed):
                return actions.Plan.Goal(
                    action_set=action_set,
                    participant=participant,
                    evaluation_episodes=_PLAN_EPISODES,
                    seed=seed,
                )
            case ask.PlayEpisodes(action_set, participant, episodes, seed, execution):
                return actions.RunPolicy.Goal(
                    action_set=action_set,
                    participant=participant,
                    episodes=episodes,
                    seed=seed,
                    execution=execution,
                )

    def _start(self, run: Any) -> None:
        sent = self._actions[type(run)].send_goal_async(
            self._goal(run), feedback_callback=lambda message: self._progress(run, message)
        )
        sent.add_done_callback(lambda done: self._accepted(run, done))

    def _progress(self, run: ask.Run, message: Any) -> None:
        if self._app.run is run:
            self._app.run_said(_progress_text(message.feedback))

    def _accepted(self, run: ask.Run, done: Future) -> None:
        handle: Any = done.result()
        if not handle.accepted:
            text = f'{ask.server(run)} did not take the request.'
            self._reply(ask.Reply(run, ok=False, text=text))
            return
        if self._app.waits_for is not run:  # the app has given up on it
            handle.cancel_goal_async()
            return
        self._handle = handle
        self._reply(ask.Reply(run, ok=True))
        handle.get_result_async().add_done_callback(lambda ended: self._ended(run, ended))

    def _ended(self, run: ask.Run, done: Future) -> None:
        self._handle = None
        ok, text = result_text(done.result().result.result, self._app.world.i_drive)
        self._app.run_ended(ask.Reply(run, ok=ok, text=text))


def _lesson_reply(request: ask.Request, answer: Answer) -> ask.Reply:
    text = answer.detail
    if answer.status is RequestStatus.PAUSED:
        text = _PAUSED
    elif isinstance(request, Drive) and not answer.ok:
        text = f'{request.action}: {answer.detail}'
    elif answer.ok and not isinstance(request, DefineOption | WithdrawDemonstration):
        text = ''
    return ask.Reply(
        request,
        ok=answer.status in CARRIED_OUT,
        text=text,
        names=answer.known_options,
        answer=answer,
    )


def result_text(result: Any, i_drive: bool) -> tuple[bool, str]:
    """
    Return whether a run went well, and how it ended in words.

    :param i_drive: whether this terminal holds control now.
    """
    kind, status = type(result), result.status
    well = [getattr(kind, f'STATUS_{name}', None) for name in _WELL]
    what = f' ({_counts(result)})' if not isinstance(result, PlanResult) else ''
    if status == getattr(kind, 'STATUS_INTERRUPTED', None) and i_drive:
        return True, f'You took over{what}.'
    if status == kind.STATUS_CANCELED:
        return True, f'Stopped{what}.'
    if status == getattr(kind, 'STATUS_NOT_AVAILABLE', None):
        return False, f'{result.detail}. A new start may suit it.'
    if status not in well:
        return False, f'{result.detail}.'
    if isinstance(result, OptionResult):
        return True, f'{result.option_name}: {result.detail}{what}.'
    return True, f'{_counts(result)}.'


def _counts(result: Any) -> str:
    if isinstance(result, OptionResult):
        steps = f'{result.step_count} step{"" if result.step_count == 1 else "s"}'
        return f'{steps}, reward {result.total_reward:g}'
    if isinstance(result, PlanResult):
        seconds = result.table_seconds + result.model_seconds + result.sweep_seconds
        return f'Planned for {result.n_states} states in {seconds:.2f} s'
    done = f'{result.successes} of {result.episodes} episodes done'
    played = done if result.episodes else 'no episode was played to its end'
    mean = f', mean return {result.mean_return:.2f}' if result.episodes else ''
    stops = f', {result.interruptions} options stopped' if result.interruptions else ''
    return f'{played}, {result.fallbacks} fallbacks{stops}{mean}'


def _progress_text(feedback: Any) -> str:
    if isinstance(feedback, actions.ExecuteOption.Feedback):
        return f'{feedback.step_count} steps, reward {feedback.total_reward:g}'
    if isinstance(feedback, actions.Plan.Feedback):
        return f'planning: {feedback.stage} {100 * feedback.progress:.0f} %'
    return f'{feedback.episodes} episodes played, {feedback.successes} done'
