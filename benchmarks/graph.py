"""
How long the graph takes for a step and for an option, beside bare rclpy.

Game and option_server are measured from this process, in turns with a bare peer, by the same code.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import closing
from typing import Any

from humanopts_env.domains.taxi import Taxi
from humanopts_interfaces.action import ExecuteOption
from humanopts_interfaces.msg import ActionCommand, GameState, NodeStatus, OptionResult
from humanopts_interfaces.srv import ResetGame, RunOption
from humanopts_learner.options.files import save_option
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.options.rollout import rollouts
from humanopts_ros.qos import CURRENT, STREAM
from humanopts_teach.launching import LaunchError
from humanopts_teach.launching.launcher import Launcher
from humanopts_teach.launching.processes import processes, Setup
import numpy as np
from rclpy.action.client import ActionClient

from benchmarks.measure import compare, OnMeasured, Row, Times
from benchmarks.planning import TaxiCase
from benchmarks.processes import bench_spec, Client, launched, NAMESPACE, own_place

QUICK = (2, 20, 3)
SIDE = 5  # of the Taxi grid
LENGTHS = (1, 8)  # steps of the runs that are timed
_MOVES = ('north', 'south')
BARE_STEP = 'the same two messages, a bare node'
BARE = {
    'service': 'a bare service of the same type',
    'action': 'a bare action of the same type',
}
NAMES = {'service': 'run_option', 'action': 'execute_option, goal to result'}


def measure(
    progress: OnMeasured, rounds: int = 10, steps: int = 150, calls: int = 20
) -> list[Row]:
    """
    Measure in rounds; of each kind one more comes first, and is not counted.

    While steps are measured, nobody else reads the states, as nobody does of the bare peer.

    :param steps: a round; Taxi cuts an episode off after 200.
    :param calls: of each kind, a round.
    :raises LaunchError: a process died, or does not answer.
    """
    with own_place() as folder:
        setup = Setup('taxi', folder, {'rows': SIDE, 'cols': SIDE}, teach=False, record=False)
        option = TaxiCase(SIDE).learned[0]
        save_option(setup.options, option, ())
        specs = {spec.name: spec for spec in processes(setup)}
        found: list[dict[str, list[Times]]] = [{} for _ in range(rounds + 1)]
        parts = (
            ('steps', _Steps, ['game'], steps),
            ('services and actions', _Runs, ['game', 'option_server'], calls),
        )
        for part, (what, kind, nodes, count) in enumerate(parts):
            progress(part / len(parts), 'starting the nodes')
            started = [*map(specs.__getitem__, nodes), bench_spec('bench_peer')]
            with (
                launched(started, folder / what) as launcher,
                closing(kind(launcher, option)) as measured,
            ):
                for number, turns in enumerate(found, start=1):
                    turns |= measured.take(count)
                    done = (part + number / len(found)) / len(parts)
                    progress(done, f'{what} over ROS')
    return latencies(found[1:])


def latencies(rounds: Sequence[Mapping[str, Sequence[Times]]]) -> list[Row]:
    """
    Set each kind of latency beside its bare form.

    :param rounds: samples by the name of the measurement: ``step``, ``service K`` and
        ``action K`` of K steps, and the same after ``bare``.
    """
    turns = {name: np.array([found[name] for found in rounds]) for name in rounds[0]}
    bare_step = turns['bare step']
    rows = [compare('a command, to the next state', turns['step'], BARE_STEP, bare_step)]
    for via, name in NAMES.items():
        for k in LENGTHS:
            own, facts = turns[f'{via} {k}'], {'steps': k}
            what = f'{name}, {k} step' + 's' * (k > 1)
            rows.append(compare(what, own, BARE[via], turns[f'bare {via}'], facts=facts))
            if k > 1:
                rows.append(compare(f'{what}: a step', own / k, BARE_STEP, bare_step, facts=facts))
    return rows


def start_of(option: LearnedOption, steps: int) -> str:
    """Return the first start state of Taxi from which an option takes so many steps to its end."""
    domain = Taxi(SIDE, SIDE)
    states = [domain.state_at(int(index)) for index in domain.start_states()]
    runs = rollouts(option, domain, states)
    found = np.flatnonzero(runs.reached & (runs.steps == steps))
    return domain.encode(states[int(found[0])])


class _Measured(ABC):
    """Clients that begin episodes and see their states, and those of a subclass."""

    def __init__(self, launcher: Launcher, option: LearnedOption) -> None:
        self._option = option.name
        self._starts = {steps: start_of(option, steps) for steps in LENGTHS}
        self._reset = Client(launcher, 'bench_reset')
        self._await_ready(set(launcher.node_names))
        self._resets = self._reset.node.create_client(ResetGame, 'reset_game')
        self._reset.until(self._resets.service_is_ready, 'reset_game')
        self._game = _Stepper(launcher, 'bench_step')
        self._clients: list[Client] = [self._reset, self._game]

    def _await_ready(self, missing: set[str]) -> None:
        def keep(status: NodeStatus) -> None:
            if status.state == NodeStatus.STATE_READY:
                missing.discard(status.node)

        statuses = self._reset.node.create_subscription(NodeStatus, 'node_status', keep, CURRENT)
        self._reset.until(lambda: not missing, 'the nodes')
        self._reset.node.destroy_subscription(statuses)

    def close(self) -> None:
        """Leave the graph."""
        for client in self._clients:
            client.close()

    @abstractmethod
    def take(self, count: int) -> dict[str, list[Times]]:
        """Take one round of so many samples by the name of the measurement."""

    def _begin(self, length: int) -> int:
        """
        Begin an episode where the option takes so many steps; return its number.

        :raises LaunchError: game refuses.
        """
        request = ResetGame.Request(
            start_state=self._starts[length], source=ResetGame.Request.SOURCE_MACHINE
        )
        reply = self._reset.ask(self._resets.call_async(request), 'reset_game')
        if reply.status != ResetGame.Response.STATUS_OK:
            raise LaunchError(f'game refused an episode: {reply.detail}')
        self._game.until(lambda: self._game.at == (reply.episode, 0), 'the first state')
        return int(reply.episode)


class _Steps(_Measured):
    """Steps of game, and of a peer that does the same."""

    def __init__(self, launcher: Launcher, option: LearnedOption) -> None:
        super().__init__(launcher, option)
        self._echo = _Stepper(launcher, 'bench_echo', 'bare/')
        self._clients.append(self._echo)

    def take(self, count: int) -> dict[str, list[Times]]:
        episode = self._begin(LENGTHS[0])
        return {
            'step': self._game.steps(episode, count),
            'bare step': self._echo.steps(episode, count),
        }


class _Runs(_Measured):
    """Runs of an option by option_server, and answers of a peer that runs nothing."""

    def __init__(self, launcher: Launcher, option: LearnedOption) -> None:
        super().__init__(launcher, option)
        self._runs = {via: _Runner(launcher, via) for via in NAMES}
        self._bare = {via: _Runner(launcher, via, 'bare/') for via in NAMES}
        self._clients += [*self._runs.values(), *self._bare.values()]

    def take(self, count: int) -> dict[str, list[Times]]:
        found = {}
        for via, bare in self._bare.items():
            found[f'bare {via}'] = [bare.run(option_name=self._option)[0] for _ in range(count)]
            for length in LENGTHS:
                found[f'{via} {length}'] = [self._run(via, length) for _ in range(count)]
        return found

    def _run(self, via: str, length: int) -> Times:
        """
        Run an option for so many steps; return the time.

        :raises LaunchError: it takes other steps.
        """
        episode = self._begin(length)
        times, result = self._runs[via].run(option_name=self._option, episode=episode)
        if (result.status, result.step_count) != (OptionResult.STATUS_REACHED, length):
            raise LaunchError(f'a run of {length} steps ended otherwise: {result.detail}')
        return times


class _Stepper(Client):
    """Sends a command, waits for the state that answers it, and so on."""

    def __init__(self, launcher: Launcher, name: str, prefix: str = '') -> None:
        super().__init__(launcher, name)
        self._commands = self.node.create_publisher(ActionCommand, f'{prefix}action', STREAM)
        self.node.create_subscription(GameState, f'{prefix}game_state', self._keep, STREAM)
        self.at = (0, 0)  # episode and step of the newest state
        self.until(self._commands.get_subscription_count, f'who takes {prefix}action')

    def _keep(self, state: GameState) -> None:
        self.at = (state.episode, state.step)

    def steps(self, episode: int, count: int) -> list[Times]:
        """Take steps from the first state of an episode; return the time of each."""
        return [self._step(episode, step) for step in range(count)]

    def _step(self, episode: int, step: int) -> Times:
        command = ActionCommand(
            publisher_id=f'{NAMESPACE}/{self.node.get_name()}#00000000',
            sequence=step + 1,
            source=ActionCommand.SOURCE_MACHINE,
            episode=episode,
            step=step,
            action=_MOVES[step % len(_MOVES)],
        )
        began = self.clocks()
        self._commands.publish(command)
        self.until(lambda: self.at == (episode, step + 1), f'the answer to step {step}')
        return self.clocks() - began


class _Runner(Client):
    """Runs an option by a service, or by an action; returns the time and the result."""

    def __init__(self, launcher: Launcher, via: str, prefix: str = '') -> None:
        super().__init__(launcher, f'bench_{prefix.rstrip("/")}{via}')
        if via == 'service':
            self.run = self._call
            self._client = self.node.create_client(RunOption, f'{prefix}run_option')
            self.until(self._client.service_is_ready, f'{prefix}run_option')
        else:
            self.run = self._act
            self._action = ActionClient(self.node, ExecuteOption, f'{prefix}execute_option')
            self.until(self._action.server_is_ready, f'{prefix}execute_option')

    def _call(self, **request: Any) -> tuple[Times, OptionResult]:
        asked = RunOption.Request(**request)
        began = self.clocks()
        reply = self.ask(self._client.call_async(asked), 'run_option')
        return self.clocks() - began, reply.result

    def _act(self, **goal: Any) -> tuple[Times, OptionResult]:
        wanted = ExecuteOption.Goal(**goal)
        began = self.clocks()
        handle = self.ask(self._action.send_goal_async(wanted), 'the goal to be accepted')
        reply = self.ask(handle.get_result_async(), 'the result')
        return self.clocks() - began, reply.result.result
