"""
Makes docs/reference/screens.md: every screen of the dialogue, in Taxi and in Pac-Man.

The whole graph runs, with the terminal in an emulator. The keys are those of a person who shows
what the reference option does.

    make screens
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from io import StringIO
import os
from pathlib import Path
import re
import signal
import sys
import tempfile
import time
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.capabilities import feature_groups
from humanopts_env.domains.reference import ReferenceOption
from humanopts_env.domains.registry import make_domain, reference_options
from humanopts_interfaces.msg import GameState
from humanopts_ros.environment import prepare_discovery
from humanopts_ros.qos import CURRENT
import pexpect
import psutil
import pyte
import rclpy
from rclpy.node import Node
from rich.console import Console
from rich.segment import Segment, Segments
from rich.style import Style
from rich.terminal_theme import DIMMED_MONOKAI

PAGE = Path('docs/reference/screens.md')
PICTURES = PAGE.with_suffix('')
TITLES = {'taxi': 'Taxi', 'pacman': 'Pac-Man', 'study': 'A study'}
HEAD = """# Screens

Every screen of one person's dialogue in the terminal, at 80 x 24 and at 120 x 40. `make screens`
makes the pictures and this page: the whole graph runs, and a program presses the keys. The page in
the browser shows the same in [a form of its own](../how-to/teach-in-a-browser.md).
"""
FILM = Path('docs/images/teach.svg')  # of these screens, one after the other
FRAMES = ('name', 'question', 'start', 'criteria', 'watched', 'finished', 'plan', 'played')
SHOWN = 2.5  # s that each is shown
SIZES = ((80, 24), (120, 40))
PATIENCE = 180.0  # s for a screen to come
REDRAW = 3.0  # s for the first output after the size has changed
STILL = 0.25  # s without output, after which a screen is complete
KEYS = {'up': '\x1b[A', 'down': '\x1b[B', 'right': '\x1b[C', 'left': '\x1b[D'}
FINISHED = 'This lesson is finished.'
ENTER, ESCAPE, BACKSPACE = '\r', '\x1b', '\x7f'
SVG = """<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {terminal_width} {terminal_height}">
<style>text{{white-space:pre;font:{char_height}px/{line_height}px monospace}}{styles}</style>
<rect width="100%" height="100%" fill="#191919"/>
{backgrounds}{matrix}</svg>"""


@dataclass
class Person:
    """Reads the screens of a terminal, presses keys, and keeps pictures."""

    name: str  # that the names of pictures begin with
    domain: Domain[Any]
    option: ReferenceOption
    terminal: Any  # pexpect.spawn
    node: Node
    pictures: list[tuple[str, str]] = field(default_factory=list)  # name, and what is shown
    newest: GameState = field(default_factory=GameState)
    screen: pyte.Screen = field(default_factory=lambda: pyte.Screen(*SIZES[0]))

    def __post_init__(self) -> None:
        self.stream = pyte.ByteStream(self.screen)
        self.node.create_subscription(GameState, 'current_state', self._on_state, CURRENT)

    def look(self, seconds: float = 0.05) -> bool:
        """Take in what comes in a time; return whether something was drawn."""
        rclpy.spin_once(self.node, timeout_sec=0.0)
        try:
            self.stream.feed(self.terminal.read_nonblocking(1 << 16, seconds))
        except pexpect.TIMEOUT:
            return False
        except pexpect.EOF as end:
            raise SystemExit(f'the command ended:\n{self.text}') from end
        return True

    def wait_until(self, holds: Callable[[], bool], what: str, seconds: float = 0.05) -> None:
        """Take in what comes until something holds."""
        deadline = time.monotonic() + PATIENCE
        while not holds():
            self.look(seconds)
            if time.monotonic() > deadline:
                raise SystemExit(f'waited in vain for {what}:\n{self.text}')

    def see(self, *texts: str) -> None:
        """Wait until one of the texts is on the screen."""
        self.wait_until(lambda: any(text in self.text for text in texts), ' or '.join(texts))

    @property
    def text(self) -> str:
        """What is on the screen; wrapped lines stay apart."""
        return '\n'.join(self.screen.display)

    def press(self, *keys: str, until: str = '') -> None:
        """Press keys, and wait for a text; empty: until nothing more is drawn."""
        for key in keys:
            self.terminal.send(KEYS.get(key, key))
        if until:
            self.see(until)
            return
        while self.look(STILL):
            pass

    def keep(
        self, name: str, shown: str, *keys: str, choose: str = '', see: Sequence[str] = ()
    ) -> None:
        """
        Press keys, pick an item, wait for one of some texts, and keep pictures in every size.

        :param name: of the pictures.
        :param shown: what they show.
        """
        if keys:
            self.press(*keys)
        if choose:
            self.choose(choose)
        if see:
            self.see(*see)
        for width, height in (*SIZES[1:], SIZES[0]):
            self.terminal.setwinsize(height, width)
            self.screen.resize(height, width)
            deadline = time.monotonic() + REDRAW
            while not self.look() and time.monotonic() < deadline:
                pass
            self.press()
            picture = PICTURES / f'{self.name}-{name}-{width}.svg'
            picture.write_text(_svg(self.screen), 'utf-8')
        self.pictures.append((name, shown))

    def choose(self, text: str) -> None:
        """Pick an item of a list."""
        self.see(text)
        number = re.search(rf'(\d) {re.escape(text)}', self.text)
        assert number is not None, f'{text} has no number:\n{self.text}'
        self.press(number[1])

    def answer(self) -> None:
        """Answer the questions as the reference option has it; those about a group come first."""
        groups = {name: group for group in feature_groups(self.domain) for name in group.features}
        wanted = set(self.option.features)
        asked: set[str] = set()  # groups
        for name in (feature.name for feature in self.domain.features):
            group = groups.get(name)
            depends = group is None or not wanted.isdisjoint(group.features)
            if group is not None and group.words not in asked:
                asked.add(group.words)
                self.press('y' if depends else 'n')
            if depends:
                self.press('y' if name in wanted else 'n')

    def show(self) -> None:
        """Show the option from the start that is there, or say that it cannot start."""
        self.see('next: start')
        self.press()
        if not self.option.can_start(self.state):
            self.press('n')
            return
        began = True
        while began or not self.option.ends(self.state):
            began = False
            action = self.domain.actions[self.option.optimal_actions(self.state)[0]]
            before = self.newest.step
            self.terminal.send(KEYS.get(action.key, action.key))
            self.wait_until(lambda: self.newest.step != before, 'a step', 0.01)  # noqa: B023
        self.press(ENTER)
        self.see('next: start', FINISHED)

    @property
    def state(self) -> Any:
        """The state of the game."""
        return self.domain.decode(self.newest.state)

    def _on_state(self, message: GameState) -> None:
        self.newest = message


def _svg(screen: pyte.Screen) -> str:
    """Return a picture of a screen."""
    console = Console(record=True, width=screen.columns, file=StringIO(), color_system='truecolor')
    segments = []
    for row in range(screen.lines):
        for column in range(screen.columns):
            cell = screen.buffer[row][column]
            if cell.data:  # the second half of a wide character has none
                segments.append(Segment(cell.data, _style(cell)))
        segments.append(Segment.line())
    console.print(Segments(Segment.simplify(segments)), end='')
    svg = console.export_svg(theme=DIMMED_MONOKAI, code_format=SVG, unique_id='s')
    return re.sub(r' clip-path="[^"]*"', '', svg).replace('&#160;', ' ')


def _style(cell: Any) -> Style:
    def colour(name: str) -> str | None:
        if name == 'default':
            return None
        is_hex = len(name) == 6 and set(name) <= set('0123456789abcdef')
        return (
            f'#{name}' if is_hex else name.replace('brown', 'yellow').replace('bright', 'bright_')
        )

    return Style(
        color=colour(cell.fg),
        bgcolor=colour(cell.bg),
        bold=cell.bold or None,
        reverse=cell.reverse or None,
    )


@contextmanager
def _person(domain: Domain[Any], option: str, name: str, words: Sequence[str]) -> Iterator[Person]:
    """Run a command of humanopts in an emulated terminal, and have a person sit before it."""
    height, width = SIZES[0][::-1]
    PICTURES.mkdir(exist_ok=True)
    for old in PICTURES.glob(f'{name}-*.svg'):
        old.unlink()
    command = ['-m', 'humanopts_teach', *words]
    with tempfile.TemporaryDirectory() as out:
        command += ['--study' if name == 'study' else '--out', out]
        terminal = pexpect.spawn(sys.executable, command, dimensions=(height, width), timeout=None)
        node = Node('screens')
        try:
            yield Person(name, domain, reference_options(domain)[option], terminal, node)
        finally:
            terminal.kill(signal.SIGINT)
            terminal.wait()
            node.destroy_node()


def teach(name: str, option: str, shown: int) -> list[tuple[str, str]]:
    """
    Go through the dialogue.

    :param option: that is taught.
    :param shown: number of demonstrations after which its criteria are shown.
    :return: names of the pictures, and what they show.
    """
    with _person(make_domain(name), option, name, ['teach', name]) as person:
        person.keep('who', 'Who teaches', see=['Who teaches?'])
        person.keep('begin', 'The menu at the beginning', ENTER, see=['What next?'])
        person.keep('game', 'What the game is about', '?')
        person.keep('free', 'Driving freely', ESCAPE, choose='Drive freely')
        person.press(ESCAPE)
        person.choose('Teach a new option')
        person.keep('name', 'Naming an option', option)
        person.keep('question', 'A question', ENTER, see=['question 1 of', 'If yes,'])
        person.answer()
        person.keep('ready', 'Before the first start', see=['Enter shows start 1'])
        person.keep('start', 'A start', ENTER, see=['next: start 1'])
        person.keep('keys', 'What the keys do', '?')
        person.press(ESCAPE)
        if name == 'taxi':
            person.keep('effect', 'A step without effect', 'd')
            ends = ['Does the option end here?']
            person.keep('confirm', 'Done, after a step without effect', ENTER, see=ends)
            person.press(ESCAPE, BACKSPACE)
        for _ in range(shown):
            person.show()
        person.keep('criteria', f'After {shown} starts')
        person.keep('list', 'What was shown', 'l', see=['What was shown'])
        # the first that was shown
        person.keep('one', 'A demonstration', 'up', ENTER, see=['Delete it'])
        person.press(ENTER, until='single step')
        person.press(' ', until='The machine waits.')
        # it has taken one step at least
        person.keep('watched', 'The machine runs the option in a demonstration, and waits', '.')
        person.press(person.domain.actions[0].key, until='You took over')
        person.press(ENTER)
        if 'no effect' in person.text:
            person.press(ENTER)
        count = ['The machine took the first']
        person.keep('counts', 'Whether the steps of the machine count', see=count)
        person.press(ESCAPE, BACKSPACE)
        person.press('l', 'up', ENTER, until='Delete it')
        person.press(ENTER, until='single step')
        person.press(' ', until='The machine waits.')
        person.press('.')
        person.press(ENTER, until='press the key again')
        person.press(ENTER, until='The machine took the first')
        person.choose('Yes')  # it was no end when it was shown
        shown_before = ['Shown differently before']
        contradicts = 'What contradicts an earlier demonstration'
        person.keep('contradiction', contradicts, see=shown_before)
        person.choose('Keep the earlier one')
        while FINISHED not in person.text:
            person.show()
        person.keep('finished', 'All criteria hold')
        person.press(ESCAPE)
        person.choose('Run a taught option')
        person.keep('which', 'Which option to run', see=['Run which option?'])
        person.keep('run', 'Before an option is run', '1')
        ran = [' steps,', ' step,', 'or try a new start.']
        person.keep('ran', 'After an option has run', 'n', ENTER, see=ran)
        person.press(ESCAPE)
        person.choose('Change an option')
        person.keep('change', 'Changing an option', '1', see=['Rename it'])
        person.keep('rename', 'Renaming it', choose='Rename it')
        person.keep('delete', 'Deleting it', ESCAPE, choose='Delete it')
        person.press(ESCAPE, ESCAPE, ESCAPE)
        person.choose('Watch the machine play')
        person.keep('plan', 'Plan with what', see=['Plan with what?'])
        person.keep('watch', 'Before the machine plays', '1')
        person.press(ENTER, until='single step')
        person.keep('played', 'The machine has played', *'+++++', see=['episodes done'])
        if 'what is not covered' in person.text:
            person.keep('places', 'What the options do not cover', 'c')
            person.press(ESCAPE)
        recorder = next(
            child
            for child in psutil.Process().children(recursive=True)
            if '.recorder ' in ' '.join(child.cmdline())
        )
        recorder.suspend()
        person.keep('paused', 'Nothing is recorded', see=['PAUSED'])
        recorder.resume()
        return person.pictures


def take_part() -> list[tuple[str, str]]:
    """
    Go through the parts that a study adds.

    :return: names of the pictures, and what they show.
    """
    plan = 'examples/study/plan.yaml'
    domain, option = make_domain('taxi'), 'go to passenger and pickup'
    with _person(domain, option, 'study', ['study', plan, '--participant', 'p1']) as person:
        person.keep('consent', 'Consent', see=['I agree'])
        person.keep('welcome', 'A page', 'y', see=['go on'])
        while 'go on with the study' not in person.text:
            person.press(ENTER)
        person.keep('play', 'Getting to know the game')
        person.press(ESCAPE)
        button = 'A button that would make it easier'
        person.keep('button', button, see=['Which button'])
        person.press(ESCAPE)
        person.keep('teach', 'The menu while the person teaches', see=['What next?'])
        person.choose('Finish teaching')
        person.see('higher')
        person.keep('scale', 'A question on a scale', 'right')
        return person.pictures


def _page(sections: Mapping[str, Sequence[tuple[str, str]]]) -> str:
    """Return the page that shows all pictures, by the first word of their names."""
    lines = [HEAD.rstrip()]
    for name, pictures in sections.items():
        lines += ['', f'## {TITLES[name]}']
        for picture, shown in pictures:
            lines += ['', f'### {shown}', '']
            lines += [f'![{shown}](screens/{name}-{picture}-{width}.svg)' for width, _ in SIZES]
    return '\n'.join(lines) + '\n'


def _film() -> str:
    """Return an animated picture; where nothing moves, it shows the first screen."""
    pictures = [(PICTURES / f'taxi-{name}-80.svg').read_text('utf-8') for name in FRAMES]
    head = pictures[0].partition('>')[0] + '>'
    share, seconds = 100 / len(pictures), SHOWN * len(pictures)
    style = (
        f'.frame{{opacity:0;animation:show {seconds}s step-end infinite}}'
        f'@keyframes show{{0%{{opacity:1}}{share}%{{opacity:0}}}}'
    )
    parts = [head, f'<style>{style}</style>']
    for number, picture in enumerate(pictures):
        inner = picture.partition('>')[2].removesuffix('</svg>').replace('s-r', f'f{number}r')
        shown = f' class="frame" style="animation-delay:{SHOWN * number}s"' if number else ''
        parts.append(f'<g{shown}>{inner}</g>')
    return ''.join([*parts, '</svg>'])


def main() -> None:
    """Make all pictures and the page."""
    os.environ.setdefault('TERM', 'xterm-256color')
    prepare_discovery()
    rclpy.init()
    sections = {
        'taxi': teach('taxi', 'go to passenger and pickup', 12),
        'pacman': teach('pacman', 'go to the nearest power pellet', 12),
        'study': take_part(),
    }
    PAGE.write_text(_page(sections), encoding='utf-8')
    FILM.write_text(_film(), encoding='utf-8')
    rclpy.shutdown()


if __name__ == '__main__':
    main()
