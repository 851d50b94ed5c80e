"""
Times of a step and of an option on the graph, compared with bare rclpy.

Game and option_server are measured from this process, as is a bare peer that answers immediately.
Since the time of a message depends on how busy the processor was just before, the step of a run is
compared with bare steps taken between the runs.
"""

from collections.abc import Callable, Iterator
from contextlib import closing, ExitStack
from functools import partial
from statistics import median
import time
from typing import Any

from humanopts_env.domains.taxi import Taxi
from humanopts_interfaces.action import ExecuteOption
from humanopts_interfaces.msg import ActionCommand, GameState, NodeStatus, OptionResult
from humanopts_interfaces.srv import ResetGame, RunOption
from humanopts_learner.options.files import save_option
from humanopts_learner.options.learn import learn_option
from humanopts_ros.node_base import RESULT_TIMEOUT
from humanopts_ros.qos import CURRENT, STREAM
from humanopts_teach.launching.launcher import Launcher
from humanopts_teach.launching.processes import processes, Setup
import pytest
from rclpy.action.client import ActionClient

from benchmarks.learning import demonstrations
from benchmarks.processes import Client, launched, NAMESPACE, own_place, own_spec

SHORT, LONG = LENGTHS = (1, 8)  # steps of the timed runs
STEPS = 150  # per episode; the limit of Taxi is 200
ROUNDS, WARM_UP = 200, 20


@pytest.fixture(scope='module')
def game(request: pytest.FixtureRequest) -> Iterator['Game']:
    """Launch nodes and the bare peer; only option_server or this process reads the states."""
    with own_place() as folder:
        setup = Setup('taxi', folder, teach=False, record=False)
        shown = demonstrations(Taxi())
        option = learn_option(shown, Taxi(), 1)
        save_option(setup.options, option, ())
        starts = {len(demo.actions): demo.states[0] for demo in shown}
        names = request.param
        specs = [spec for spec in processes(setup) if spec.name in names]
        with (
            launched([*specs, own_spec('bench_peer')], folder) as launcher,
            closing(
                Game(launcher, option.name, starts, drives='option_server' not in names)
            ) as client,
        ):
            yield client


class Game(Client):
    """Start episodes and take steps, in the game or with the bare peer."""

    def __init__(
        self, launcher: Launcher, option: str, starts: dict[int, str], *, drives: bool
    ) -> None:
        """
        Wait for the nodes.

        :param drives: whether to take steps in the game, too, and not only with the bare peer.
        """
        super().__init__(launcher, 'bench_game')
        self.option, self.launcher, self._starts = option, launcher, starts
        missing = set(launcher.node_names)

        def keep(status: NodeStatus) -> None:
            if status.state == NodeStatus.STATE_READY:
                missing.discard(status.node)

        self.node.create_subscription(NodeStatus, 'node_status', keep, CURRENT)
        self._resets = self.node.create_client(ResetGame, 'reset_game')
        self.until(lambda: not missing and self._resets.service_is_ready(), 'the nodes')
        self.episode = self.step_number = 0
        self._at: dict[str, tuple[int, int]] = {}  # episode and step of the newest state
        prefixes = ('', 'bare/') if drives else ('bare/',)
        self._commands = {prefix: self._connect(prefix) for prefix in prefixes}

    def _connect(self, prefix: str) -> Any:
        def keep(state: GameState) -> None:
            self._at[prefix] = (state.episode, state.step)

        self.node.create_subscription(GameState, f'{prefix}game_state', keep, STREAM)
        commands = self.node.create_publisher(ActionCommand, f'{prefix}action', STREAM)
        self.until(commands.get_subscription_count, f'a reader of {prefix}action')
        return commands

    def begin(self, length: int) -> None:
        """Start an episode in which the option takes this number of steps."""
        source = ResetGame.Request.SOURCE_MACHINE
        request = ResetGame.Request(start_state=self._starts[length], source=source)
        reply = self.ask(self._resets.call_async(request), 'reset_game')
        assert reply.status == ResetGame.Response.STATUS_OK, reply.detail
        self.episode, self.step_number = reply.episode, 0
        if '' in self._commands:
            self.until(lambda: self._at.get('') == (self.episode, 0), 'the first state')

    def step(self, prefix: str) -> None:
        """Send a command and wait for the resulting state."""
        step = self.step_number
        command = ActionCommand(
            publisher_id=f'{NAMESPACE}/{self.node.get_name()}#00000000',
            sequence=step + 1,
            source=ActionCommand.SOURCE_MACHINE,
            episode=self.episode,
            step=step,
            action=('north', 'south')[step % 2],
        )
        self._commands[prefix].publish(command)
        self.step_number += 1
        answered = (self.episode, self.step_number)
        self.until(lambda: self._at.get(prefix) == answered, f'the answer to step {step}')


@pytest.mark.parametrize('game', [('game',)], indirect=True, ids=['game'])
@pytest.mark.parametrize('prefix', ['', 'bare/'], ids=['game', 'a bare node'])
def bench_step(benchmark: Any, game: Game, prefix: str) -> None:
    """Take steps in episodes from a start state."""
    benchmark.group = 'a command, to the next state'
    benchmark.name = 'a bare node' if prefix else 'game'
    game.begin(LONG)

    def begin() -> None:
        if game.step_number >= STEPS:
            game.begin(LONG)

    benchmark.pedantic(game.step, (prefix,), setup=begin, rounds=8 * ROUNDS, warmup_rounds=STEPS)


@pytest.mark.parametrize('game', [('game', 'option_server')], indirect=True, ids=['option_server'])
@pytest.mark.parametrize('length', [*LENGTHS, 0], ids=lambda steps: f'{steps} steps')
@pytest.mark.parametrize('via', ['run_option', 'execute_option'])
def bench_run(benchmark: Any, game: Game, via: str, length: int) -> None:
    """Run an option by service or action; with 0 steps, the bare peer answers."""
    bare = 'a bare ' + ('service' if via == 'run_option' else 'action')
    benchmark.group, benchmark.name = via, f'{length} steps' if length else bare
    prefix = '' if length else 'bare/'
    with ExitStack() as stack:
        client = stack.enter_context(closing(Client(game.launcher, f'bench_{via}')))
        if via == 'run_option':
            service = client.node.create_client(RunOption, prefix + via)
            client.until(service.service_is_ready, via)
        else:
            action = ActionClient(client.node, ExecuteOption, prefix + via)
            stack.callback(action.destroy)
            time.sleep(RESULT_TIMEOUT)  # until then, kept results slow down goal statuses
            client.until(action.server_is_ready, via)

        def run() -> Any:
            if via == 'run_option':
                request = RunOption.Request(option_name=game.option, episode=game.episode)
                return client.ask(service.call_async(request), via).result
            goal = ExecuteOption.Goal(option_name=game.option, episode=game.episode)
            handle = client.ask(action.send_goal_async(goal), 'the goal to be accepted')
            return client.ask(handle.get_result_async(), 'the result').result.result

        short: list[float] = []
        steps: list[float] = []

        def begin() -> None:
            if length == LONG:
                game.begin(SHORT)
                short.append(_seconds(run))
                steps.extend(_seconds(partial(game.step, 'bare/')) for _ in range(LONG - SHORT))
            game.begin(length or SHORT)

        result = benchmark.pedantic(run, setup=begin, rounds=ROUNDS, warmup_rounds=WARM_UP)
    assert result.status == OptionResult.STATUS_REACHED, result.detail
    assert length in (result.step_count, 0), result.detail
    if length == LONG and benchmark.stats is not None:  # None: nothing is measured
        whole = benchmark.stats.stats.data
        del short[:WARM_UP], steps[: WARM_UP * (LONG - SHORT)]
        # Not by minima: that of a long run is far from the sum of the minima of its steps.
        step = (median(whole) - median(short)) / (LONG - SHORT)
        benchmark.extra_info['a step in bare steps'] = round(step / median(steps), 2)


def _seconds(act: Callable[[], object]) -> float:
    began = time.perf_counter()
    act()
    return time.perf_counter() - began
