"""Options of a world in which actions take time: deadlines, stops, refreshed states, refusals."""

from collections.abc import Iterator
from typing import Any
import uuid

from action_msgs.msg import GoalStatus
from graph_support.live import Goal, Graph, open_graph, OPTION_SERVER
from graph_support.slow_world import DOMAIN, SECONDS, SlowWorld
from humanopts_interfaces.action import ExecuteOption
from humanopts_interfaces.msg import (
    ActionRefusal,
    AvailableOptions,
    ControlState,
    OptionResult,
)
from humanopts_interfaces.srv import QueryOption, ResetGame, RunOption
from humanopts_learner.demonstrations import Demonstration, Kind
from humanopts_learner.options.files import save_option
from humanopts_learner.options.learn import learn_option
from humanopts_ros.qos import CURRENT
import numpy as np
import pytest
from unique_identifier_msgs.msg import UUID

WORLD = 'graph_support.slow_world:SlowWorld'
PATIENCE = 2.0  # s
FAR = 'drive far'


def demonstration(number: int, *xs: float) -> Demonstration:
    """Show driving through these places; "not here" where it is one."""
    kind = Kind.TRAJECTORY if len(xs) > 1 else Kind.NOT_HERE
    return Demonstration(
        kind=kind,
        uuid=str(uuid.UUID(int=number, version=4)),
        option_name=FAR,
        domain=DOMAIN.name,
        domain_parameters='{}',
        participant='p1',
        session='s1',
        number=number,
        chosen_features=('x',),
        feature_names=('x',),
        features=tuple((x,) for x in xs),
        states=tuple(f'x {x:g}' for x in xs),
        actions=('drive',) * (len(xs) - 1),
        rewards=(-1.0,) * (len(xs) - 1),
        terminated=False,
    )


class Robot:
    """The slow world, and the option server that drives it."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.world: SlowWorld = graph.start(WORLD)
        shown = [demonstration(n, *np.linspace(n, 10, 6)) for n in (0, 1, 2)]
        option = learn_option([*shown, *(demonstration(n, n) for n in (20, 30))], DOMAIN, 0)
        folder = graph.folder / 'options'
        save_option(folder, option, [])
        self.results = graph.listen(OptionResult, 'option_results')
        self.available = graph.listen(AvailableOptions, 'available_options', CURRENT)
        graph.start(OPTION_SERVER, options_directory=folder, no_progress_seconds=PATIENCE)
        graph.ready('/slow', '/option_server')

    def reset(self) -> None:
        self.world.obeys = True
        self.graph.ask(ResetGame, 'reset_game')

    def begin(self, name: str = FAR, **fields: Any) -> Goal:
        """Begin a run at the start, and wait for its first action."""
        self.reset()
        goal = self.graph.act(ExecuteOption, 'execute_option', option_name=name, **fields)
        self.graph.until(lambda: self.world.acting, 'the first action')
        return goal

    def beep(self) -> int:
        """Run an action without duration, and return the status."""
        result = self.graph.ask(RunOption, 'run_option', option_name='action:beep').result
        return int(result.status)

    def can_start(self) -> bool:
        """Return whether the option can start in the current state."""
        return bool(self.graph.ask(QueryOption, 'query_option', option_name=FAR).can_start)

    def refused(self, name: str, **fields: Any) -> OptionResult:
        """Send a goal that is rejected, and return the published result."""
        known = len(self._refusals())
        assert not self.graph.accepts(ExecuteOption, 'execute_option', option_name=name, **fields)
        self.graph.until(lambda: len(self._refusals()) > known, 'the result of the refusal')
        return self._refusals()[-1]

    def _refusals(self) -> list[OptionResult]:
        return [result for result in self.results if result.run_id == UUID()]


@pytest.fixture(scope='module')
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    with open_graph(tmp_path_factory.mktemp('slow')) as graph:
        yield Robot(graph)


def test_a_run_waits_for_each_action_up_to_its_own_deadline(robot: Robot) -> None:
    goal = robot.begin()
    with robot.graph.hurried():
        waits_until(robot, 0.5 * SECONDS)
    robot.world.progress(0.5 * SECONDS)
    robot.graph.until(lambda: goal.feedback, 'feedback while the action lasts')
    assert (goal.feedback[-1].action, goal.feedback[-1].step_count) == ('drive', 0)
    robot.world.finish(9.9)
    status, result = goal.result()
    assert (status, result.status) == (GoalStatus.STATUS_SUCCEEDED, OptionResult.STATUS_REACHED)
    assert (result.step_count, result.final_state) == (1, 'x 9.9')

    goal = robot.begin()
    with robot.graph.hurried():
        _, result = goal.result(60.0)
    assert result.status == OptionResult.STATUS_NO_PROGRESS
    assert f'deadline: {SECONDS + PATIENCE:g} s' in result.detail
    robot.graph.until(lambda: robot.world.acting is None, 'the stop of what is under way')


def waits_until(robot: Robot, seconds: float) -> None:
    """Let time of the nodes pass."""
    clock = robot.graph.node_called('/option_server').monotonic
    end = clock() + seconds
    robot.graph.until(lambda: clock() > end, 'the time')


def test_a_cancel_stops_the_action_and_the_run_ends_with_the_state_that_answers(
    robot: Robot,
) -> None:
    goal = robot.begin()
    goal.cancel()
    status, result = goal.result()
    assert (status, result.status) == (GoalStatus.STATUS_CANCELED, OptionResult.STATUS_CANCELED)
    assert (result.step_count, result.final_state) == (1, 'x 0.5')
    assert robot.world.acting is None


def test_a_cancel_that_the_world_does_not_answer_ends_the_run_all_the_same(robot: Robot) -> None:
    goal = robot.begin()
    robot.world.obeys, stops = False, robot.world.stops
    goal.cancel()
    robot.graph.until(lambda: robot.world.stops > stops, 'the stop')
    with robot.graph.hurried():
        status, result = goal.result()
    assert (status, result.status) == (GoalStatus.STATUS_CANCELED, OptionResult.STATUS_CANCELED)
    assert (result.step_count, robot.world.stops) == (0, stops + 1)
    assert result.detail == 'it was canceled: the game did not respond to the stop'


def test_an_action_without_duration_is_not_stopped(robot: Robot) -> None:
    stops = robot.world.stops
    robot.reset()
    assert robot.beep() == OptionResult.STATUS_REACHED
    assert robot.world.stops == stops


def test_an_action_that_is_cut_short_interrupts_the_run_and_says_why(robot: Robot) -> None:
    nobody = ControlState.HOLDER_NOBODY
    for stopped, holder, said in (
        ('/scan is silent', nobody, '/scan is silent'),
        ('', ControlState.HOLDER_LOCKED, 'the service stop was called'),
    ):
        goal = robot.begin()
        robot.world.finish(0.25, cut_short=True)
        robot.world.progress(stopped=stopped)  # the reason comes after the state
        robot.world.control(holder, said)
        status, result = goal.result()
        assert status == GoalStatus.STATUS_ABORTED
        assert result.status == OptionResult.STATUS_INTERRUPTED
        assert result.detail == f'it was interrupted: drive was stopped before its end: {said}'
        assert (result.step_count, result.final_state) == (1, 'x 0.25')
        robot.world.progress()
        robot.world.control(nobody, 'the person gave control back')
        robot.graph.until(lambda: robot.beep() == OptionResult.STATUS_REACHED, 'its end')


def test_a_refreshed_state_replaces_the_one_from_which_a_run_starts(robot: Robot) -> None:
    robot.reset()
    robot.world.refresh(20.0)
    robot.graph.until(lambda: not robot.can_start(), 'the refreshed state')
    far = robot.refused(FAR)
    assert far.status == OptionResult.STATUS_NOT_AVAILABLE
    assert far.detail.endswith(': x 20')
    robot.world.refresh(1.5)
    robot.graph.until(robot.can_start, 'the next one')
    goal = robot.graph.act(ExecuteOption, 'execute_option', option_name=FAR)
    robot.graph.until(lambda: robot.world.acting, 'the first action')
    goal.cancel()
    assert goal.result()[1].step_count == 1


def test_a_goal_that_cannot_run_is_rejected_and_the_reason_is_published(
    robot: Robot, capfd: pytest.CaptureFixture[str]
) -> None:
    robot.reset()
    unknown = robot.refused('fly')
    assert unknown.status == OptionResult.STATUS_UNKNOWN_OPTION
    assert f'execute_option of fly: {unknown.detail}' in capfd.readouterr().err
    running = robot.begin()
    busy = robot.refused(FAR)
    assert (busy.status, busy.detail) == (
        OptionResult.STATUS_BUSY,
        f'refused: another run is under way: {FAR}',
    )
    robot.world.finish(3.0, truncated=True)
    status, result = running.result()
    assert status == GoalStatus.STATUS_ABORTED  # truncation is no success
    assert (result.status, result.truncated) == (OptionResult.STATUS_EPISODE_OVER, True)
    over = robot.refused(FAR)
    assert over.status == OptionResult.STATUS_NO_EPISODE
    robot.reset()
    robot.world.control(ControlState.HOLDER_LOCKED, 'no one has taken control')
    robot.graph.until(lambda: robot.beep() == OptionResult.STATUS_INTERRUPTED, 'the lock')
    assert robot.refused(FAR).detail == (
        'it was interrupted: the robot is locked (no one has taken control): take control and '
        'give it back'
    )
    robot.world.control(ControlState.HOLDER_NOBODY, 'the person gave control back')
    robot.graph.until(lambda: robot.beep() == OptionResult.STATUS_REACHED, 'its end')
    robot.world.progress(stopped='/scan is silent')
    robot.graph.until(lambda: robot.beep() == OptionResult.STATUS_INTERRUPTED, 'the fault')
    assert robot.refused(FAR).detail == 'it was interrupted: /scan is silent'
    robot.world.progress()
    robot.graph.until(lambda: robot.beep() == OptionResult.STATUS_REACHED, 'its end')


def test_a_refused_command_ends_the_run_with_the_reason(robot: Robot) -> None:
    for reason in (ActionRefusal.REASON_PAUSED, ActionRefusal.REASON_LOCKED):
        goal = robot.begin()
        assert robot.world.acting is not None
        robot.world.refuse(robot.world.acting, reason, '/scan is silent')
        robot.world.acting = None
        _, result = goal.result()
        assert result.status == OptionResult.STATUS_INTERRUPTED
        assert result.detail == 'it was interrupted: /scan is silent'


@pytest.mark.parametrize('via', ['run_option', 'execute_option'])
def test_a_request_preempts_the_run_under_way(robot: Robot, via: str) -> None:
    first = robot.begin()
    if via == 'run_option':
        asked = {'option_name': 'action:beep', 'preempt': True}
        reply = robot.graph.request(RunOption, 'run_option', **asked)
        robot.graph.until(reply.done, 'its end')
        result = reply.result().result
    else:
        second = robot.graph.act(
            ExecuteOption, 'execute_option', option_name='action:beep', preempt=True
        )
        _, result = second.result()
    status, before = first.result()
    assert (status, before.status) == (
        GoalStatus.STATUS_ABORTED,
        OptionResult.STATUS_INTERRUPTED,
    )
    assert before.detail == 'it was interrupted: action:beep preempted it'
    assert (before.step_count, before.final_state) == (1, 'x 0.5')
    assert (result.status, result.first_step) == (OptionResult.STATUS_REACHED, 1)


def test_the_newest_of_several_preempting_requests_runs(robot: Robot) -> None:
    robot.begin()
    robot.world.obeys = False
    asked = {'option_name': FAR, 'preempt': True}
    waiting, newest = (robot.graph.request(RunOption, 'run_option', **asked) for _ in range(2))
    robot.graph.until(waiting.done, 'the end of the request that waited')
    assert waiting.result().result.status == OptionResult.STATUS_INTERRUPTED
    robot.world.finish(4.0)
    robot.graph.until(lambda: robot.world.acting, 'the action of the newest')
    robot.world.finish(9.9)
    robot.graph.until(newest.done, 'its end')
    assert newest.result().result.status == OptionResult.STATUS_REACHED


def test_the_available_options_are_published_when_they_change(robot: Robot) -> None:
    (listed,) = robot.available
    assert (listed.option_names, listed.participants) == ([FAR], ['p1'])
    assert listed.n_demonstrations.tolist() == [3]
    assert listed.primitive_actions == ['action:drive', 'action:beep']


def test_an_option_server_that_is_ended_stops_the_robot_and_answers(robot: Robot) -> None:
    """The last test: it ends the server."""
    goal = robot.begin()
    stops = robot.world.stops
    robot.graph.stop(robot.graph.node_called('/option_server'))
    _, result = goal.result()
    assert result.status == OptionResult.STATUS_FAILED
    assert result.detail == 'it failed: option_server is stopping'
    assert (robot.world.acting, robot.world.stops) == (None, stops + 1)
