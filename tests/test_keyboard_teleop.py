"""A person at the terminal: real key presses through a pseudo-terminal, on the real graph."""

from collections.abc import Callable, Iterator
from io import StringIO
import os
import re
import select
import signal
import statistics
import sys
import time
from typing import Any

from graph_support.live import (
    GAME,
    Graph,
    KEYBOARD,
    LEARNER,
    LESSON,
    module_of,
    OPTION_SERVER,
    PLANNER,
)
from graph_support.taxi_person import demonstrate, name_and_answer, OPTIONS, TAXI
from graph_support.terminal import (
    CTRL_C,
    ENTER,
    ESCAPE,
    HEIGHT,
    key_for,
    run_to_judge,
    Terminal,
    WIDTH,
)
from humanopts_interfaces.msg import (
    ActionRefusal,
    ControlState,
    ExecutionState,
    GameState,
    OptionResult,
)
from humanopts_learner.demonstrations import GOAL, TREES
from humanopts_ros.qos import CURRENT, STREAM
from humanopts_teach.ros import keyboard_teleop
import pytest

PICKUP = 'go to passenger and pickup'
KEYS, MEDIAN = 50, 150.0  # that are measured; ms that a key may take to the screen


def open_terminal(graph: Graph, *arguments: str) -> Terminal:
    """Start Python in a terminal on a graph."""
    return Terminal(arguments, graph.domain_id, graph.spin)


class Terminals:
    """The other nodes, terminals on their graph, and a reader of the game's stream."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.terminals: list[Terminal] = []
        self.messages: list[Any] = []
        self.subscriptions = [
            graph.node.create_subscription(kind, topic, self.messages.append, STREAM)
            for kind, topic in (
                (GameState, 'game_state'),
                (ActionRefusal, 'action_refused'),
                (OptionResult, 'option_results'),
                (ExecutionState, 'execution'),
            )
        ]

    def start_all(self, step_period: float = 0.0, learn: str = TREES) -> None:
        """Start every node but the terminal."""
        graph = self.graph
        graph.start(GAME, step_period=step_period)
        graph.start(LEARNER, directory=graph.folder / 'options')
        folder = graph.folder / 'demonstrations'
        graph.start(LESSON, directory=folder, strategy='failures', learn=learn)
        graph.start(OPTION_SERVER)
        streams = self.subscriptions[:-1]
        graph.until(lambda: all(s.get_publisher_count() for s in streams), 'game, option server')

    def terminal(self) -> Terminal:
        """Start a terminal on the graph."""
        terminal = open_terminal(self.graph, '-m', module_of(KEYBOARD))
        self.terminals.append(terminal)
        return terminal

    def sit_down(self, terminal: Terminal | None = None) -> Terminal:
        """Come as p1 to a terminal, which is started where there is none."""
        terminal = terminal or self.terminal()
        terminal.see('Who is teaching? > p1')
        terminal.press(ENTER)
        terminal.see('What next?')
        return terminal

    def witness(self, kind: type, condition: Callable[[Any], bool], terminal: Terminal) -> Any:
        """Return the first message that fits."""
        found: list[Any] = []

        def look() -> bool:
            found.extend(m for m in self.messages if isinstance(m, kind) and condition(m))
            return bool(found)

        terminal.until(look, f'a {kind.__name__}')
        return found[0]


@pytest.fixture
def terminals(live: Graph) -> Iterator[Terminals]:
    opened = Terminals(live)
    yield opened
    for terminal in opened.terminals:
        terminal.close()


def show(terminal: Terminal, *numbers: int) -> None:
    """Demonstrate as the yardstick means it, from what is on the screen, until runs are judged."""
    for number in numbers:
        terminal.until(
            lambda n=number: f'next: start {n} ' in terminal.words() or judges(terminal),
            f'start {number}',
        )
        if judges(terminal):
            return
        demonstrate(terminal, OPTIONS[PICKUP])


def judges(terminal: Terminal) -> bool:
    return bool(run_to_judge(terminal.words()))


def judge(terminal: Terminal) -> None:
    """Answer questions about runs, and take the exam: all runs are right."""
    asked = ['']

    def ends() -> bool:
        if (about := run_to_judge(terminal.words())) not in ('', asked[-1]):
            asked.append(about)
            terminal.press({'enter': ENTER}.get(key := key_for(about), key))
        return 'This lesson is finished.' in terminal.words()

    terminal.until(ends, 'the end of the lesson', 60.0)


def test_an_option_is_taught_by_key_presses_left_resumed_and_run(terminals: Terminals) -> None:
    terminals.start_all(learn=GOAL)
    terminal = terminals.sit_down()
    name_and_answer(terminal, PICKUP)
    show(terminal, 1)
    terminal.see('next: start 2 ')
    terminal.press('q')
    assert terminal.ended() == 0
    assert terminal.restored()

    again = terminals.sit_down()
    again.press('2')
    again.see(f'> 1 {PICKUP}')
    again.press('1')
    again.see('Enter shows start 2.')
    again.press(ENTER)
    show(again, *range(2, 12))
    judge(again)
    again.see('learned: 5 of 5 runs in the exam were right, so at least 57 % are')
    again.see('initiation')

    again.press('r')
    again.see(f'Run: {PICKUP}')
    again.press('n')
    again.see('step 0')
    again.press(ENTER)
    again.see(f'{PICKUP}: ')
    result = terminals.witness(OptionResult, lambda m: True, again)
    assert result.status == OptionResult.STATUS_REACHED
    assert TAXI.decode(result.final_state).passenger == 4  # aboard
    again.press('q')
    assert again.ended() == 0
    assert again.restored()


def test_a_key_takes_the_wheel_from_the_machine_and_a_cut_connection_ends_the_terminal(
    terminals: Terminals,
) -> None:
    terminals.start_all(step_period=0.3)
    terminal = terminals.sit_down()
    name_and_answer(terminal, PICKUP)
    show(terminal, 1, 2)
    terminal.see('next: start 3 ')
    terminal.press(ESCAPE)
    terminal.see('What next?')
    terminal.press('3')
    terminal.see('Run which option?')
    terminal.press(ENTER)
    terminal.see(f'Run: {PICKUP}')
    for number in range(1, 30):  # until a start from which the run is long enough to be seen
        terminal.press('n')
        terminal.see('step 0')
        terminal.press(ENTER)
        terminal.until(
            lambda: (
                'The machine is driving. 1 steps' in terminal.words()
                or f'{PICKUP}: ' in terminal.text()
                or 'initiation' in terminal.text()
            ),
            f'run {number}',
        )
        if 'The machine is driving. 1 steps' in terminal.words():
            break
    terminal.press('d')
    terminal.see('You took over')
    result = terminals.witness(
        OptionResult, lambda m: m.status == OptionResult.STATUS_INTERRUPTED, terminal
    )
    refused = [m for m in terminals.messages if isinstance(m, ActionRefusal)]
    reasons = {m.reason for m in refused if m.episode == result.episode}
    assert reasons <= {ActionRefusal.REASON_HELD_BY_PERSON}  # none if the run stops sooner
    terminal.see('you drive')
    terminal.press('left')

    def persons(message: Any, action: str) -> bool:
        at = (message.episode, message.previous_action, message.action_source)
        return at == (result.episode, action, GameState.SOURCE_PERSON)

    terminals.witness(GameState, lambda m: persons(m, 'west'), terminal)  # all before it has come
    states = [m for m in terminals.messages if isinstance(m, GameState)]
    assert sum(persons(state, 'dropoff') for state in states) == 1
    terminal.hang_up()
    terminals.graph.until(lambda: terminal.process.poll() is not None, 'the end')
    assert terminal.process.returncode == 0


def drive(terminal: Terminal, step: int) -> None:
    """Choose to drive, and take one step, with which the person takes control."""
    terminal.see('Drive freely')
    (number,) = re.findall(r'(\d) Drive freely', terminal.text())
    terminal.press(number)
    terminal.see(f'step {step}')
    terminal.press('left')
    terminal.see(f'step {step + 1}')
    terminal.see('you drive')


def test_a_terminal_waits_for_the_game_drives_again_after_it_was_killed_and_quits_without_a_lesson(
    terminals: Terminals,
) -> None:
    graph = terminals.graph
    killed = terminals.terminal()
    killed.see('Waiting for the game')
    killed.see('Missing: game, lesson.')
    graph.start(GAME)
    graph.start(LESSON, directory=graph.folder / 'demonstrations')
    controls = graph.listen(ControlState, 'control', CURRENT)
    terminals.sit_down(killed)
    drive(killed, 0)
    graph.until(lambda: len(controls) >= 2, 'control to be taken')
    first = controls[-1].holder_id
    killed.process.kill()
    killed.process.wait()
    terminal = terminals.sit_down()
    drive(terminal, 1)
    graph.until(lambda: len(controls) >= 4, 'control to be taken again')
    assert [c.holder for c in controls] == [0, 1, 0, 1]
    assert controls[-1].holder_id != first
    assert controls[-1].holder_id.partition('#')[0] == '/keyboard_teleop'
    refusals = [m for m in terminals.messages if isinstance(m, ActionRefusal)]
    assert refusals == []
    graph.stop(graph.node_called('/lesson'))
    terminal.see('Missing: lesson. Everything taught is saved; Ctrl-C quits.')
    terminal.press(CTRL_C)
    assert terminal.ended() == 0
    assert terminal.restored()


def test_a_key_changes_how_the_machine_plays_within_the_episode_and_a_signal_ends_the_terminal(
    terminals: Terminals,
) -> None:
    terminals.start_all(step_period=0.3)
    terminals.graph.start(PLANNER)
    terminal = terminals.sit_down()
    terminal.press('3')
    terminal.see('Plan with what?')
    terminal.press('2')
    terminal.see('Execution: each option runs to its end.')
    terminal.press(ENTER)
    terminals.witness(GameState, lambda m: m.step > 0, terminal)
    for execution, words in (
        ('interrupted', 'an option stops where another is worth more.'),
        ('modular_mass', 'all options act at once; the greatest mass wins.'),
    ):
        terminal.press('x')
        said = terminals.witness(
            ExecutionState, lambda m, wanted=execution: m.execution == wanted, terminal
        )
        terminal.see(f'Execution: {words}')
    last = max(m.sequence for m in terminals.messages if isinstance(m, GameState))
    terminals.witness(GameState, lambda m: m.sequence > last + 2, terminal)
    terminal.press(ESCAPE)
    terminal.see('Stopped')
    run = terminals.witness(OptionResult, lambda m: m.execution == 'modular_mass', terminal)
    assert (said.previous, run.option_name) == ('interrupted', '')
    assert run.first_step > 0
    terminal.process.send_signal(signal.SIGTERM)
    assert terminal.ended() == 0
    assert terminal.restored()


def test_an_exception_restores_the_terminal(live: Graph) -> None:
    terminal = open_terminal(
        live,
        '-c',
        'from humanopts_teach.terminal.device import Device\n'
        'with Device() as device:\n'
        '    device.draw(lambda width, height, colours: [f"{width} x {height}"])\n'
        '    raise RuntimeError("as a defect would")',
    )
    assert terminal.ended() == 1
    assert f'{WIDTH} x {HEIGHT}'.encode() in terminal.raw
    assert terminal.restored()
    terminal.close()


def test_without_a_terminal_it_says_so_in_one_line(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, 'stdin', StringIO())
    assert keyboard_teleop.main() == 2
    out, err = capsys.readouterr()
    said = 'humanopts: no lesson at this terminal: it needs a terminal for input and output\n'
    assert (out, err) == ('', said)


def test_the_picture_of_an_environment_follows_each_key(terminals: Terminals) -> None:
    graph = terminals.graph
    graph.spawn(GAME, domain='gymnasium:MiniGrid-DoorKey-8x8-v0')
    graph.spawn(LESSON, directory=graph.folder / 'demonstrations')
    terminal = terminals.terminal()
    for words, key in (('Who is teaching?', ENTER), ('4 Drive freely', '4')):
        terminal.see(words)
        terminal.press(key)
    terminal.see('Nothing you do here counts as a demonstration')
    waits = []
    for step in range(1, KEYS + 1):
        began, frame = time.perf_counter(), b''
        terminal.press('right' if step % 2 else 'left')
        while b'step %d' % step not in frame:  # the emulator would take longer than the screen
            assert select.select([terminal.master], [], [], 30.0)[0]
            frame += os.read(terminal.master, 65536)
        waits.append(1e3 * (time.perf_counter() - began))
        assert '▀'.encode() in frame
    print(f'{KEYS} keys: median {statistics.median(waits):.0f} ms, last {max(waits):.0f} ms')
    assert statistics.median(waits) < MEDIAN
