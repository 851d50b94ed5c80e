"""
Faults while the simulated rover drives: ``make faults FAULTS=100 SEED=1``.

An option drives it to the charger, or a person turns it. Then a process is killed or stopped, a
sensor goes silent or blind, the cable to another host is pulled, or someone stops the robot.
Measured is the time until its wheels stand still, and stay so. At the end nothing may be missing
in the recording.
"""

import argparse
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
import itertools
import math
import os
from pathlib import Path
import random
import signal
import subprocess
import sys
import tempfile
import time
from typing import Any

from geometry_msgs.msg import PoseStamped
from humanopts_env.worlds.sensors import Sensors
from humanopts_env.worlds.world import load_world, World
from humanopts_interfaces.msg import ControlState, GameState
from humanopts_interfaces.srv import ResetGame, RunOption
from humanopts_learner.demonstrations import Demonstration, Kind
from humanopts_learner.options.files import save_option
from humanopts_learner.options.learn import learn_option
from humanopts_ros.qos import CURRENT
from humanopts_ros.workarounds import prepare_discovery
from humanopts_rover import messages
from humanopts_rover.simulation import Simulation
from humanopts_teach.bags.reader import open_bag
from nav_msgs.msg import Odometry
import pandas as pd
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from graph_support.hosts import CABLE, enter_network, two_hosts
from graph_support.live import (
    Graph,
    module_of,
    NodeProcess,
    open_graph,
    OPTION_SERVER,
    RECORDER,
    WORLD,
)

WORLD_FILE = Path(__file__).parents[2] / 'examples/humanopts_rover/worlds/rover.yaml'
TERMINAL = Path(__file__).with_name('terminal_node.py')
CHARGER = 'go to the charger'
START = (1.0, 4.4, 0.0)  # far from the charger
LATE = 0.5  # s within which the wheels stand still
PATIENCE = 3.0  # s to wait for that
STILL = 1.0  # s that they must stay still
DRIVERS = BY_OPTION, BY_PERSON = 'an option', 'a person'
KINDS = {  # each fault, and who may drive meanwhile
    'option server killed': (BY_OPTION,),
    'option server stopped': (BY_OPTION,),
    'terminal killed': (BY_OPTION, BY_PERSON),
    'terminal stopped': (BY_OPTION, BY_PERSON),
    'terminal closed': (BY_OPTION, BY_PERSON),
    'world killed': (BY_OPTION, BY_PERSON),
    'world stopped': (BY_OPTION, BY_PERSON),
    'scan stale': (BY_OPTION, BY_PERSON),
    'scan NaN': (BY_OPTION, BY_PERSON),
    'emergency topic': (BY_OPTION, BY_PERSON),
    'service stop': (BY_OPTION,),  # who holds a key drives on: the emergency topic stops them too
}
CUT = 'cable pulled'  # to the host of option server and terminal


@dataclass(frozen=True)
class Measured:
    """What one fault led to."""

    kind: str
    driver: str
    seconds: float  # until the wheels stood still; infinite: they did not
    stayed: bool  # still, as long as the fault lasted


def demonstrations(world: World, count: int) -> list[Demonstration]:
    """Drive simulated rovers to the charger by rule."""
    return [_demonstration(world, number) for number in range(1, count + 1)]


def _demonstration(world: World, number: int) -> Demonstration:
    rover, sensors = Simulation(number), Sensors(world.file.topics)
    rover.place(*START)
    rows: list[tuple[float, ...]] = []
    actions: list[str] = []
    while True:
        for name, message in messages.sensed(rover).items():
            sensors.note(name, message, 0.0)
        rows.append(world.sense(sensors).features)
        now = dict(zip(world.file.features, rows[-1]))
        if now['charger_distance'] < 0.4:
            break
        off = now['charger_bearing']
        actions.append('forward' if abs(off) < 0.3 else 'left' if off > 0 else 'right')
        twist = world.file.actions[actions[-1]].twist
        assert twist is not None
        linear, angular = twist.vectors
        rover.step(linear[0], angular[2], world.file.step)
    return Demonstration(
        kind=Kind.TRAJECTORY,
        uuid=f'00000000-0000-4000-8000-{number:012}',
        domain=world.domain.name,
        domain_parameters='{}',
        participant='p1',
        session='s1',
        option_name=CHARGER,
        number=number,
        chosen_features=('charger_bearing', 'charger_distance'),
        feature_names=tuple(world.file.features),
        features=tuple(rows),
        states=tuple(world.text(row) for row in rows),
        actions=tuple(actions),
        rewards=(-1.0,) * len(actions),
    )


class Course:
    """The rover, the nodes around it, and a person's terminal."""

    def __init__(self, graph: Graph, seed: int, elsewhere: Sequence[str] = ()) -> None:
        """
        Start everything, with an option that was learned from three demonstrations.

        :param elsewhere: command before those of option server and terminal, which runs them on
            another host.
        """
        self.graph, self._elsewhere = graph, elsewhere
        self._chance = random.Random(seed)
        self._at: list[tuple[float, float]] = []  # times of odometry, and the speed of the wheels
        self.states: list[GameState] = graph.listen(GameState, 'game_state')
        self._controls: list[ControlState] = graph.listen(ControlState, 'control', CURRENT)
        node = graph.node
        self._odometry: list[Odometry] = []
        node.create_subscription(Odometry, 'odom', self._on_odometry, 10)
        self._hand = node.create_publisher(PoseStamped, 'carry_to', 10)
        self._emergency = node.create_publisher(Bool, 'emergency_stop', 10)
        world = load_world(f'ros:{WORLD_FILE}')
        option = learn_option(demonstrations(world, 3), world.domain, 0)
        self._options = graph.folder / 'options'
        save_option(self._options, option, [])
        self._alive: dict[str, NodeProcess] = {}
        self.stops = 0  # without a fault
        self._bags = 0
        self._rover = graph.run(['-m', 'humanopts_rover.node'], 'rover')
        for name in ('recorder', 'world', 'option_server'):
            self._start(name)
        self._ready()

    def _on_odometry(self, message: Odometry) -> None:
        twist = message.twist.twist
        self._at.append((time.monotonic(), math.hypot(twist.linear.x, twist.angular.z)))
        self._odometry[:] = [message]

    def _start(self, name: str, **parameters: Any) -> None:
        """Start a node, again if it was killed."""
        graph, known = self.graph, self._alive.get(name)
        if known is not None and known.process.poll() is None:
            known.go_on()
            return
        graph.statuses.pop(f'/{name}', None)
        if name == 'recorder':
            self._bags += 1
            given = {'path': graph.folder / f'bag{self._bags}', 'expect_recorder': False}
            self._alive[name] = graph.spawn(RECORDER, **given)
        elif name == 'world':
            self._alive[name] = graph.spawn(WORLD, world=WORLD_FILE, expect_recorder=True)
        elif name == 'option_server':
            given = {'options_directory': self._options, 'expect_recorder': True}
            command = ['-m', module_of(OPTION_SERVER), '--ros-args']
            self._alive[name] = graph.run(command, name, given, before=self._elsewhere)
        else:
            command = [str(TERMINAL), '--ros-args']
            self._alive[name] = graph.run(command, name, parameters, before=self._elsewhere)

    def _ready(self) -> None:
        self.graph.ready('/recorder', '/world', '/option_server')

    def measure(self, kind: str, driver: str) -> Measured:
        """Let something drive the rover, inject a fault, and watch the wheels."""
        graph = self.graph
        for name in ('recorder', 'world', 'option_server'):
            self._start(name)
        self._ready()
        self._still(10.0)
        self._carry(START)
        try:
            self._take(driver)
            graph.until(lambda: self._at[-1][1] > 0.1, f'{driver} to drive', 30.0)
            goes_on = time.monotonic() + self._chance.uniform(0.8, 1.4)
            graph.until(lambda: time.monotonic() > goes_on, 'the moment of the fault')
            graph.until(lambda: self._at[-1][1] > 0.1, f'{driver} to drive on', 2.0)
        except AssertionError:  # it stopped without a fault
            self.stops += 1
            return self.measure(kind, driver)
        with self._fault(kind) as began:
            seconds = self._still(PATIENCE) - began
            until = time.monotonic() + STILL
            known = len(self._at)
            graph.until(lambda: time.monotonic() > until, 'the wheels to move again')
            stayed = all(speed < 0.01 for _, speed in self._at[known:])
        return Measured(kind, driver, seconds, stayed)

    def _take(self, driver: str) -> None:
        """Let a terminal enable the machine and an option run, or let a person drive."""
        graph = self.graph
        if (known := self._alive.pop('terminal', None)) and known.process.poll() is None:
            known.kill(signal.SIGKILL)
        known = len(self._controls)
        self._start('terminal', drives='left' if driver == BY_PERSON else '')
        if driver == BY_PERSON:
            return
        graph.until(
            lambda: (
                any(c.supervisor_id for c in self._controls[known:])
                and self._controls[-1].holder == ControlState.HOLDER_NOBODY
            ),
            'the machine to be enabled',
        )
        source = ResetGame.Request.SOURCE_MACHINE
        begun = graph.ask(ResetGame, 'reset_game', source=source, seed=1)
        assert begun.status == begun.STATUS_OK, begun.detail
        asked = {'option_name': CHARGER, 'episode': begun.episode, 'max_steps': 200}
        graph.request(RunOption, 'run_option', **asked)

    def _carry(self, to: tuple[float, float, float]) -> None:
        pose = PoseStamped()
        at = pose.pose
        at.position.x, at.position.y, at.orientation = to[0], to[1], messages.quaternion(to[2])
        self._hand.publish(pose)

        def arrived() -> bool:
            here = self._odometry[-1].pose.pose.position
            return math.dist((here.x, here.y), to[:2]) < 0.1

        self.graph.until(arrived, 'the hand')

    def _still(self, patience: float) -> float:
        """Wait until the wheels stand still; return when they first did."""
        deadline = time.monotonic() + patience
        while time.monotonic() < deadline:
            self.graph.spin()
            now = time.monotonic()
            late = [(at, speed) for at, speed in self._at if at > now - 0.4]
            if len(late) > 3 and all(speed < 0.01 for _, speed in late):
                moved = [at for at, speed in self._at if speed >= 0.01]
                return next(at for at, _ in self._at if not moved or at > moved[-1])
        return math.inf

    @contextmanager
    def _fault(self, kind: str) -> Iterator[float]:
        """Inject a fault; yield when it began; undo it where that is possible."""
        graph, (subject, _, how) = self.graph, kind.rpartition(' ')
        name = subject.replace(' ', '_')
        began = time.monotonic()
        if how == 'killed':
            self._alive[name].process.kill()
            self._alive[name].expected.add(-signal.SIGKILL)
        elif how == 'stopped':
            self._alive[name].pause()
        elif how == 'closed':
            self._alive[name].process.send_signal(signal.SIGHUP)
        elif subject == 'scan':
            self._set_scan('stopped' if how == 'stale' else 'nan')
            began = time.monotonic()
        elif kind == 'emergency topic':
            self._emergency.publish(Bool(data=True))
        elif kind == CUT:
            subprocess.run(['ip', 'link', 'set', CABLE, 'down'], check=True)
        else:
            assert kind == 'service stop'
            graph.request(Trigger, 'stop')
        yield began
        if kind == CUT:
            subprocess.run(['ip', 'link', 'set', CABLE, 'up'], check=True)
        if how == 'killed':
            self._alive.pop(name).process.wait(10.0)
        elif how == 'stopped':
            # The nodes that it did not answer for so long count it as dead.
            self._alive[name].go_on()
        elif subject == 'scan':
            self._set_scan('none')
        elif kind == 'emergency topic':
            self._emergency.publish(Bool(data=False))

    def _set_scan(self, fault: str) -> None:
        given = [Parameter('scan_fault', value=fault).to_parameter_msg()]
        self.graph.ask(SetParameters, 'rover/set_parameters', parameters=given)

    def finish(self) -> list[tuple[str, int]]:
        """
        End the recording; return the states that it lacks, as publisher and sequence.

        The last state of a killed world may have reached this process and not the recorder.
        """
        for name in ('terminal', 'option_server', 'world', 'recorder'):
            if process := self._alive.pop(name, None):
                process.kill(signal.SIGTERM)
        self._rover.kill(signal.SIGKILL)
        recorded = {
            (each.message.publisher_id, each.message.sequence)
            for number in range(1, self._bags + 1)
            for each in open_bag(self.graph.folder / f'bag{number}').messages(['/game_state'])
        }
        seen = {(state.publisher_id, state.sequence) for state in self.states}
        last = dict(sorted(seen))  # the highest sequence of each publisher
        return sorted(seen - recorded - last.items())


def plan(kinds: Sequence[str], faults: int, seed: int) -> list[tuple[str, str]]:
    """Return ``faults`` faults with their drivers, shuffled, each kind equally often."""
    pairs = [(kind, driver) for kind in kinds for driver in KINDS.get(kind, DRIVERS)]
    chosen = list(itertools.islice(itertools.cycle(pairs), faults))
    random.Random(seed).shuffle(chosen)
    return chosen


def inject(
    folder: Path, faults: Sequence[tuple[str, str]], seed: int, elsewhere: Sequence[str] = ()
) -> tuple[list[Measured], list[tuple[str, int]]]:
    """Inject faults; return what they led to, and the states that were not recorded."""
    measured = []
    with open_graph(folder) as graph:
        course = Course(graph, seed, elsewhere)
        for kind, driver in faults:
            measured.append(course.measure(kind, driver))
            print(measured[-1], flush=True)
        print(f'{course.stops} stops without a fault')
        return measured, course.finish()


def inject_between_hosts(folder: Path, *words: str) -> int:
    """Run this program on one of two hosts, with option server and terminal on the other."""
    with two_hosts(folder) as (here, there):
        command = ['-m', 'graph_support.faults', *words, '--elsewhere', str(there.pid)]
        log = here.folder / 'log'
        variables = {
            'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET',
            'PYTHONPATH': os.pathsep.join(filter(None, sys.path)),
        }
        status = here.start(command, log, **variables).wait()
    print(log.read_text('utf-8'))
    return status


def table(measured: Sequence[Measured]) -> pd.DataFrame:
    """Return how long each kind of fault took, s."""
    frame = pd.DataFrame(measured)
    frame['in_time'] = (frame.seconds < LATE) & frame.stayed
    return frame.groupby(['kind', 'driver']).agg(
        faults=('seconds', 'size'),
        in_time=('in_time', 'sum'),
        median=('seconds', 'median'),
        longest=('seconds', 'max'),
    )


def main() -> int:
    """Inject faults, and print what they led to."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--faults', type=int, default=100)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--only', choices=KINDS, metavar='FAULT', help=', '.join(KINDS))
    parser.add_argument('--cable', action='store_true', help='pull the cable between two hosts')
    parser.add_argument('--elsewhere', help=argparse.SUPPRESS)  # a process on the other host
    given = parser.parse_args()
    kinds = [CUT] if given.elsewhere else [given.only] if given.only else [*KINDS]
    with tempfile.TemporaryDirectory() as folder:
        if given.cable:
            words = ['--faults', str(given.faults), '--seed', str(given.seed)]
            return inject_between_hosts(Path(folder), *words)
        prepare_discovery()
        measured, lost = inject(
            Path(folder) / 'graph',
            plan(kinds, given.faults, given.seed),
            given.seed,
            enter_network(given.elsewhere) if given.elsewhere else (),
        )
    print(table(measured).round(2).to_string())
    in_time = sum(each.seconds < LATE and each.stayed for each in measured)
    print(f'{in_time} of {len(measured)} within {LATE} s; {len(lost)} states were not recorded')
    return 1 if in_time < len(measured) or lost else 0


if __name__ == '__main__':
    sys.exit(main())
