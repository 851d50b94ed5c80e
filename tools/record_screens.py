"""
Record the pictures of the terminal in docs/images: lessons with real keys, on a real graph.

The person follows the reference options of Taxi. ``make screens`` runs this script.
"""

from functools import partial
from itertools import groupby
from pathlib import Path
import re
import sys
import tempfile
import time
from typing import Any

from graph_support.live import free_domain_id
from graph_support.taxi_person import demonstrate, name_and_answer, OPTIONS
from graph_support.terminal import ENTER, ESCAPE, HEIGHT, key_for, run_to_judge, Terminal, WIDTH
from rich.color import Color
from rich.console import Console
from rich.style import Style
from rich.text import Text

TITLE = './humanopts teach taxi'
FIRST, SECOND = 'go to passenger and pickup', 'go to destination and dropoff'
SHOWN_AT = 7  # number of the start in the picture of the criteria
SECONDS = 2.5  # duration of each screen in the moving picture
PYTE_COLOURS = {'default': 'default', 'brown': 'yellow'}  # other names agree with rich


class Recorder:
    """A person at the terminal, and pictures of the screens."""

    def __init__(self, folder: Path, domain_id: int) -> None:
        arguments = '-m', 'humanopts_teach', 'teach', 'taxi', '--out', str(folder)
        self.terminal = Terminal(arguments, domain_id, partial(time.sleep, 0.005))
        self.screens: dict[str, Console] = {}

    def keep(self, name: str) -> None:
        """Keep a picture of the current screen, unless there is one with that name."""
        if name not in self.screens:
            self.terminal.read(0.3)
            self.screens[name] = picture(self.terminal)

    def teach(self, name: str) -> None:
        """Teach an option from the menu until it is learned."""
        terminal = self.terminal
        name_and_answer(terminal, name, self.keep)
        before = ''
        while 'This lesson is finished.' not in (words := terminal.words()):
            about = run_to_judge(words) or ''.join(re.findall(r'next: start \d+ ', words))
            if about in ('', before):
                terminal.read()
                continue
            before = about
            self.keep_for(about)
            if run_to_judge(words):
                key = key_for(about)
                terminal.press(ENTER if key == 'enter' else key)
            else:
                demonstrate(terminal, OPTIONS[name])
        self.keep('finished')

    def keep_for(self, about: str) -> None:
        """Keep the screen if the documentation shows it."""
        if 'question' in about:
            self.keep('run-question')
        elif 'right' in about:
            self.keep('exam')
        elif about == 'next: start 1 ':
            self.keep('start')
        elif about == f'next: start {SHOWN_AT} ':
            self.keep('criteria')

    def play(self) -> None:
        """Let the machine plan and play."""
        terminal = self.terminal
        for name, choice in ('menu', 'Watch the machine play'), ('plan', 'With your options'):
            terminal.see(choice)
            self.keep(name)
            found = re.search(rf'(\d) {choice}', terminal.words())
            assert found is not None
            terminal.press(found[1])
        terminal.see('plan and play')
        terminal.press(ENTER)
        terminal.see('5 of 5 episodes done', 60.0)
        self.keep('played')


def picture(terminal: Terminal) -> Console:
    """Return a console that can export the screen."""
    text = Text()
    for row in range(HEIGHT):
        cells = [terminal.screen.buffer[row][column] for column in range(WIDTH)]
        for style, alike in groupby(cells, style_of):
            text.append(''.join(cell.data for cell in alike), style)
        text.append('\n')
    console = Console(record=True, width=WIDTH, file=Path('/dev/null').open('w'))  # noqa: SIM115
    console.print(text, end='')
    return console


def style_of(cell: Any) -> Style:
    """Return the style of a cell of the emulator."""
    return Style(
        color=colour(cell.fg),
        bgcolor=colour(cell.bg),
        bold=cell.bold,
        reverse=cell.reverse,
        underline=cell.underscore,
    )


def colour(name: str) -> Color:
    """Return a colour of the emulator: a name, or six hexadecimal digits."""
    known = PYTE_COLOURS.get(name, name.replace('bright', 'bright_'))
    return Color.parse(f'#{name}' if re.fullmatch('[0-9a-f]{6}', name) else known)


def moving(frames: list[str]) -> str:
    """Return a picture that shows frames in turn; the last one where animations do not run."""
    view = re.search(r'viewBox="[^"]*"', frames[0])
    assert view is not None
    share = 100 / len(frames)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" {view.group()}><style>',
        f'.frame {{animation: show {SECONDS * len(frames)}s step-end infinite}}',
        f'@keyframes show {{0% {{visibility: visible}} {share}% {{visibility: hidden}}}}',
        '</style>',
    ]
    for number, frame in enumerate(frames):
        last = 'visible' if number == len(frames) - 1 else 'hidden'
        style = f'visibility: {last}; animation-delay: {SECONDS * (number - len(frames))}s'
        parts.append(f'<g class="frame" style="{style}">{frame}</g>')
    return '\n'.join([*parts, '</svg>', ''])


def main(images: Path) -> None:
    """Teach two options, let the machine play, and write the pictures."""
    with tempfile.TemporaryDirectory() as folder, free_domain_id() as domain_id:
        recorder = Recorder(Path(folder) / 'taxi', domain_id)
        terminal = recorder.terminal
        try:
            terminal.see('Who is teaching? > p1', 60.0)
            terminal.press(ENTER)
            for name in (FIRST, SECOND):
                recorder.teach(name)
                terminal.press(ESCAPE)
            recorder.play()
            terminal.press('q')
            assert terminal.ended() == 0
        finally:
            terminal.close()

    def svg(name: str) -> str:
        return recorder.screens[name].export_svg(title=TITLE, clear=False, unique_id=name)

    for name in ('question', 'start', 'criteria', 'run-question', 'exam', 'finished', 'played'):
        (images / f'{name}.svg').write_text(svg(name), 'utf-8')
    story = 'name', 'question', 'start', 'criteria', 'exam', 'finished', 'plan', 'played'
    (images / 'teach.svg').write_text(moving([svg(name) for name in story]), 'utf-8')


if __name__ == '__main__':
    main(Path(sys.argv[1]))
