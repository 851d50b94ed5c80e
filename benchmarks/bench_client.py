"""
Measures game and option_server, and beside them a bare peer, by the same code in turns.

Every measurement has a node and an executor of its own, so that nothing else is looked after
while the clock runs.
"""

from collections.abc import Callable
import json
from pathlib import Path
import sys
import time
from typing import Any

from humanopts_interfaces.action import ExecuteOption
from humanopts_interfaces.msg import ActionCommand, GameState, NodeStatus, OptionResult
from humanopts_interfaces.srv import ResetGame, RunOption
from humanopts_ros.node_base import NodeBase, StartError
from humanopts_ros.process import run_node
from humanopts_ros.qos import LATCHED_ALL, STREAM
from rclpy.action.client import ActionClient
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node

from benchmarks.measure import add_record

_MOVES = ('north', 'south')
_MEASURED = ('game', 'option_server', 'bench_peer')
_PATIENCE = 20.0  # s for anything that is waited for


class _Party:
    """A node that does one thing, and waits for the answer."""

    def __init__(self, name: str) -> None:
        self.node = Node(name, start_parameter_services=False, enable_rosout=False)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)

    def until(self, done: Callable[[], Any], what: str) -> None:
        """
        Carry out callbacks until something holds.

        :raises StartError: it does not come.
        """
        deadline = time.monotonic() + _PATIENCE
        while not done():
            self._executor.spin_once(1.0)
            if time.monotonic() > deadline:
                raise StartError(f'waited in vain for {what}')

    def ask(self, future: Any, what: str) -> Any:
        """Wait for an answer and return it."""
        self.until(future.done, what)
        return future.result()

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self.node.destroy_node()


class _Stepper(_Party):
    """Sends commands in lock-step with whoever answers with states."""

    def __init__(self, name: str, prefix: str = '') -> None:
        super().__init__(name)
        self._commands = self.node.create_publisher(ActionCommand, f'{prefix}action', STREAM)
        self.node.create_subscription(GameState, f'{prefix}game_state', self._keep, STREAM)
        self._at = (0, 0)
        self.until(self._commands.get_subscription_count, f'who takes {prefix}action')

    def _keep(self, state: GameState) -> None:
        self._at = (state.episode, state.step)

    def arrive(self, episode: int) -> None:
        """Wait for the first state of an episode."""
        self.until(lambda: self._at == (episode, 0), f'episode {episode}')

    def steps(self, episode: int, count: int) -> list[float]:
        """Take steps from the first state of an episode; return the seconds of each."""
        return [self._step(episode, step) for step in range(count)]

    def _step(self, episode: int, step: int) -> float:
        command = ActionCommand(
            publisher_id='/bench_client#00000000',
            sequence=step + 1,
            source=ActionCommand.SOURCE_MACHINE,
            episode=episode,
            step=step,
            action=_MOVES[step % len(_MOVES)],
        )
        began = time.perf_counter()
        self._commands.publish(command)
        self.until(lambda: self._at == (episode, step + 1), f'the answer to step {step}')
        return time.perf_counter() - began


class _Caller(_Party):
    """Calls the service that runs an option."""

    def __init__(self, name: str, prefix: str = '') -> None:
        super().__init__(name)
        self._client = self.node.create_client(RunOption, f'{prefix}run_option')
        self.until(self._client.service_is_ready, f'{prefix}run_option')

    def run(self, **request: Any) -> tuple[float, OptionResult]:
        """Call; return the seconds and the result."""
        asked = RunOption.Request(**request)
        began = time.perf_counter()
        reply = self.ask(self._client.call_async(asked), 'run_option')
        return time.perf_counter() - began, reply.result


class _Actor(_Party):
    """Sends goals to the action that runs an option."""

    def __init__(self, name: str, prefix: str = '') -> None:
        super().__init__(name)
        self._client = ActionClient(self.node, ExecuteOption, f'{prefix}execute_option')
        self.until(self._client.server_is_ready, f'{prefix}execute_option')

    def run(self, **goal: Any) -> tuple[float, OptionResult]:
        """Send a goal; return the seconds until its result is here, and the result."""
        wanted = ExecuteOption.Goal(**goal)
        began = time.perf_counter()
        handle = self.ask(self._client.send_goal_async(wanted), 'the goal to be accepted')
        reply = self.ask(handle.get_result_async(), 'the result')
        return time.perf_counter() - began, reply.result.result


class _Resetter(_Party):
    """Begins episodes."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._client = self.node.create_client(ResetGame, 'reset_game')
        self.until(self._client.service_is_ready, 'reset_game')

    def begin(self, start_state: str) -> int:
        """
        Begin an episode; return its number.

        :raises StartError: game refuses.
        """
        request = ResetGame.Request(
            start_state=start_state, source=ResetGame.Request.SOURCE_MACHINE
        )
        reply = self.ask(self._client.call_async(request), 'reset_game')
        if reply.status != ResetGame.Response.STATUS_OK:
            raise StartError(f'game refused an episode: {reply.detail}')
        return int(reply.episode)


class _Parties:
    """Everyone who measures: each of ours, and who does the same with the bare peer."""

    def __init__(self, plan: dict[str, Any]) -> None:
        self._plan = plan
        self._reset = _Resetter('bench_reset')
        self._game, self._echo = _Stepper('bench_step'), _Stepper('bench_echo', 'bare/')
        self._runs: dict[str, _Caller | _Actor] = {
            'service': _Caller('bench_run'),
            'action': _Actor('bench_act'),
        }
        self._bare: dict[str, _Caller | _Actor] = {
            'service': _Caller('bench_call', 'bare/'),
            'action': _Actor('bench_goal', 'bare/'),
        }

    def close(self) -> None:
        """Leave the graph."""
        both = (*self._runs.values(), *self._bare.values())
        for party in (self._reset, self._game, self._echo, *both):
            party.close()

    def measure(self) -> dict[str, list[float]]:
        """Take one round of samples, by the name of what they are of."""
        plan = self._plan
        episode = self._begin(plan['runs'][0]['state'])
        found = {
            'step': self._game.steps(episode, plan['steps']),
            'bare step': self._echo.steps(episode, plan['steps']),
        }
        for via, party in self._bare.items():
            calls = range(plan['calls'])
            found[f'bare {via}'] = [party.run(option_name=plan['option'])[0] for _ in calls]
            for run in plan['runs']:
                found[f'{via} {run["steps"]}'] = [self._run(via, run) for _ in calls]
        return found

    def _run(self, via: str, run: dict[str, Any]) -> float:
        """
        Run an option from a state; return the seconds.

        :raises StartError: it does not take the steps that the plan says.
        """
        episode = self._begin(run['state'])
        seconds, result = self._runs[via].run(option_name=self._plan['option'], episode=episode)
        if (result.status, result.step_count) != (OptionResult.STATUS_REACHED, run['steps']):
            raise StartError(f'a run of {run["steps"]} steps ended otherwise: {result.detail}')
        return seconds

    def _begin(self, state: str) -> int:
        episode = self._reset.begin(state)
        self._game.arrive(episode)
        return episode


class BenchClient(NodeBase):
    """Measures when the others are ready, writes the samples to a file, and waits for its end."""

    def __init__(self) -> None:
        super().__init__('bench_client')
        self._path = Path(self.setting('results', '', 'file to write'))
        self._plan = json.loads(self.setting('plan', '{}', 'JSON: what to measure'))
        self._missing = {f'{self.get_namespace().rstrip("/")}/{name}' for name in _MEASURED}
        self.create_subscription(NodeStatus, 'node_status', self._on_status, LATCHED_ALL)

    def waits_for(self) -> str | None:
        """Wait for those who are measured."""
        return ', '.join(self._missing) or None

    def _on_status(self, status: NodeStatus) -> None:
        if status.state == NodeStatus.STATE_READY:
            self._missing.discard(status.node)

    def serve(self, executor: Executor, stop: Callable[[], bool]) -> None:
        """Measure, then wait."""
        while not (self.ready or stop()):
            executor.spin_once(0.1)
        parties = _Parties(self._plan)
        rounds = self._plan['rounds']
        for number in range(rounds + 1):
            if stop():
                break
            found = parties.measure()
            share = (number + 1) / (rounds + 1)
            add_record(self._path, counted=number > 0, share=share, samples=found)
        parties.close()
        super().serve(executor, stop)


if __name__ == '__main__':
    sys.exit(run_node(BenchClient))
