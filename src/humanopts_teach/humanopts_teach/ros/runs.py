"""The runs that the terminal asks for: an option, a plan, episodes; and how they read."""

import time
from typing import Any

from humanopts_env.game import Transition
from humanopts_interfaces import action as actions
from humanopts_interfaces.msg import OptionResult, PlanResult
from humanopts_ros.node_base import NodeBase
from humanopts_ros.node_restarts import NodeRestarts
from humanopts_teach.dialogue.app import App
from humanopts_teach.lesson import requests
from humanopts_teach.lesson.requests import Answer, RequestStatus, Run, RunOption, server
from humanopts_teach.ros.convert import encode
from rclpy.action.client import ActionClient
from rclpy.task import Future

_ACTIONS: dict[type[Run], tuple[Any, str]] = {
    requests.RunOption: (actions.ExecuteOption, 'execute_option'),
    requests.PlanOptions: (actions.Plan, 'plan'),
    requests.PlayEpisodes: (actions.RunPolicy, 'run_policy'),
}
_WELL = ('REACHED', 'EPISODE_OVER', 'CONVERGED', 'NOT_CONVERGED', 'DONE')


class Runs:
    """Starts one run after the other, and reports to the app how it goes and how it ended."""

    def __init__(self, node: NodeBase, app: App) -> None:
        self._app = app
        NodeRestarts(node, self._on_restart)
        self._clients = {kind: ActionClient(node, *spec) for kind, spec in _ACTIONS.items()}
        self._handle: Any = None  # of the run under way

    def is_ready(self, run: Run) -> bool:
        """Return whether the server of a run is matched: a goal sent before would be lost."""
        return bool(self._clients[type(run)].server_is_ready())

    def start(self, run: Run) -> None:
        """Send the goal; the app gets the answer once the server has accepted it or not."""
        goal = encode(run, _ACTIONS[type(run)][0].Goal())
        if isinstance(run, RunOption):
            game = self._app.world.game or Transition()
            goal.episode, goal.step = game.episode, game.step

        def on_feedback(message: Any) -> None:
            if self._app.run is run:
                self._app.run_said(_progress_text(message.feedback))

        sent = self._clients[type(run)].send_goal_async(goal, feedback_callback=on_feedback)
        sent.add_done_callback(lambda done: self._accepted(run, done))

    def cancel(self) -> Future | None:
        """Ask for the end of the run under way; None: none is."""
        return self._handle.cancel_goal_async() if self._handle is not None else None

    def check_server(self) -> None:
        """End the run when its server is gone."""
        if self._app.run is not None and not self.is_ready(self._app.run):
            self._app.lost_server()

    def _on_restart(self, name: str) -> None:
        """End the run of a server that was started again, and does not know it."""
        if self._app.run is not None and server(self._app.run) == name:
            self._handle = None
            self._app.lost_server()

    def _accepted(self, run: Run, done: Future) -> None:
        handle: Any = done.result()
        if not handle.accepted:
            text = f'{server(run)} did not take the request.'
            self._app.replied(run, Answer(RequestStatus.REFUSED, text), time.monotonic())
            return
        if self._app.waits_for is not run:  # the app has given up on it
            handle.cancel_goal_async()
            return
        self._handle = handle
        self._app.replied(run, Answer(RequestStatus.OK, ''), time.monotonic())
        handle.get_result_async().add_done_callback(lambda ended: self._ended(run, ended))

    def _ended(self, run: Run, done: Future) -> None:
        self._handle = None
        result: Any = done.result()
        if isinstance(result.result.result, PlanResult):
            self._app.world.uncovered = _uncovered(result.result.result)
        self._app.run_ended(run, *result_text(result.result.result, self._app.world.i_drive))


def _uncovered(result: PlanResult) -> list[tuple[str, float]] | None:
    """Return the states that the options do not cover; None: not known."""
    if not result.coverage_known:
        return None
    steps = zip(result.single_step_states, result.single_step_gains)
    return [*((state, 0.0) for state in result.fallback_states), *steps]


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
