"""
People who teach in a real browser, Chromium, on the real graph.

``make test-browser`` runs them; ``make test`` leaves them out, since they need Chromium.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
import json
import os
from pathlib import Path
import re
import shutil
import signal
import statistics
import time
from typing import Any
from urllib.parse import urlsplit

from graph_support.command import Command
from graph_support.live import free_domain_id
from graph_support.terminal import key_for, run_to_judge
from humanopts_env.domains.registry import make_domain, reference_options
from humanopts_env.domains.taxi import landmark_cells, TaxiState
from humanopts_teach.bags.contents import read_demonstrations
from humanopts_teach.bags.reader import open_bag
import pytest
from selenium import webdriver
from selenium.common.exceptions import StaleElementReferenceException, WebDriverException
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from teach_support.flood import Flood

pytestmark = [pytest.mark.chromium, pytest.mark.live, pytest.mark.timeout(300)]

DESKTOP, PHONE = (1280, 800), (390, 844)
TAXI = make_domain('taxi')
PICKUP = 'go to passenger and pickup'
NASTY = '<b onclick="alert(1)">home</b> & away'
ARROWS = {
    'up': Keys.ARROW_UP,
    'down': Keys.ARROW_DOWN,
    'left': Keys.ARROW_LEFT,
    'right': Keys.ARROW_RIGHT,
}
LINGER = 4  # s
KEYS = 100  # that are measured
MEDIAN = 60.0  # ms that a key may take to the screen; the slowest depend on who else computes
STRANGERS = 2000
COUNT = 'return window.waits.length'
REQUEST = 'Network.requestWillBeSent'
STALE = StaleElementReferenceException
# Key to screen: from the key press to the frame with the changed board, in the page itself.
MEASURE = """
window.waits = [];
let pressed = 0;
document.addEventListener('keydown', () => { pressed = performance.now(); }, true);
new MutationObserver(() => {
  if (!pressed) return;
  const began = pressed, image = document.querySelector('.board img');
  const paint = () => requestAnimationFrame(() => window.waits.push(performance.now() - began));
  pressed = 0;
  image ? image.decode().then(paint) : paint();
}).observe(document.querySelector('.board'), {childList: true, subtree: true});
"""


def chromium() -> tuple[str, str]:
    """Return Chromium and its driver."""
    found = shutil.which('chromium') or shutil.which('chromium-browser')
    driver = shutil.which('chromedriver')
    if found is None or driver is None:
        pytest.fail('these tests need Chromium: sudo apt install chromium chromium-driver')
    return found, driver


class Window:
    """A window of the browser, and what a person does in it."""

    def __init__(self, size: tuple[int, int], *, dark: bool = False) -> None:
        program, driver = chromium()
        options = webdriver.ChromeOptions()
        options.binary_location = program
        for argument in ('--headless=new', '--no-sandbox', '--disable-gpu', '--hide-scrollbars'):
            options.add_argument(argument)
        options.set_capability('goog:loggingPrefs', {'performance': 'ALL', 'browser': 'ALL'})
        self.driver = webdriver.Chrome(options=options, service=Service(driver))
        measures = {'width': size[0], 'height': size[1], 'deviceScaleFactor': 1}
        self.command('Emulation.setDeviceMetricsOverride', mobile=size == PHONE, **measures)
        scheme = {'name': 'prefers-color-scheme', 'value': 'dark' if dark else 'light'}
        self.command('Emulation.setEmulatedMedia', features=[scheme])

    def command(self, name: str, **parameters: Any) -> Any:
        """Have Chromium do something."""
        return self.driver.execute_cdp_cmd(name, parameters)

    def text(self) -> str:
        """Return what can be read."""
        try:
            return ' '.join(self.driver.find_element(By.TAG_NAME, 'body').text.split())
        except WebDriverException:  # the page is being loaded
            return ''

    def until(self, condition: Callable[[], object], what: str, seconds: float = 60.0) -> None:
        """Wait for a condition."""
        deadline = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < deadline, f'waited in vain for {what}: {self.text()}'
            time.sleep(0.02)

    def see(self, words: str, seconds: float = 60.0) -> None:
        """Wait until the page shows words."""
        self.until(lambda: words in self.text(), words, seconds)

    def press(self, *keys: str) -> None:
        """Press keys on the keyboard."""
        ActionChains(self.driver).send_keys(*keys).perform()

    def click(self, words: str) -> None:
        """Press a button, by its words or its name."""

        def clicked() -> bool:
            for button in self.driver.find_elements(By.TAG_NAME, 'button'):
                try:
                    if words in button.text or words == button.get_attribute('title'):
                        button.click()
                        return True
                except STALE:
                    return False
            return False

        self.until(clicked, f'a button {words}')

    def write(self, text: str) -> None:
        """Type into the field of the page."""
        self.driver.find_element(By.TAG_NAME, 'input').send_keys(text)


@dataclass(frozen=True)
class Served:
    """Pages that are served."""

    address: str
    data: Path  # folder
    command: Command


class Person:
    """Somebody who teaches to pick the passenger up."""

    def __init__(self, window: Window, address: str, code: str, *, keys: bool) -> None:
        self.window, self.code, self.keys = window, code, keys
        self.option = reference_options(TAXI)[PICKUP]
        window.driver.get(f'{address}/{code}')

    def name_option(self, name: str = PICKUP) -> None:
        """Name the option and answer every question."""
        window = self.window
        window.see('What next?')
        self.act('enter', 'Teach a new option')
        window.see('What is the option called?')
        window.write(name)
        self.act('enter', 'OK')
        for number, feature in enumerate(TAXI.features, start=1):
            window.see(f'question {number} of {len(TAXI.features)}')
            yes = feature.name in self.option.features
            self.act('y' if yes else 'n', 'yes' if yes else 'no')
        window.see('Enter shows start 1.')
        self.act('enter', 'begin')

    def act(self, key: str, button: str) -> None:
        """Press a key, or the button for it."""
        if self.keys:
            self.window.press({**ARROWS, 'enter': Keys.ENTER}.get(key, key))
        else:
            self.window.click(button)

    def values(self) -> dict[str, int]:
        """Return the features of the lesson that are shown, by name; others are not numbers."""
        found = re.findall(r'(\w+ \w+) (\d+)\b', self.features())
        return {name.replace(' ', '_'): int(value) for name, value in found}

    def features(self) -> str:
        """Return the text of the features; empty while the page draws them anew."""
        try:
            found = self.window.driver.find_element(By.CLASS_NAME, 'features').text
            return ' '.join(found.split('\n'))
        except WebDriverException:
            return ''

    def state(self) -> TaxiState:
        """Return the state that is shown; what is hidden is anything."""
        known = self.values()
        cells = list(landmark_cells(5, 5).values())
        aboard = 'passenger in taxi yes' in self.features()
        cell = known.get('passenger_row', -1), known.get('passenger_col', -1)
        passenger = 4 if aboard else cells.index(cell)
        return TaxiState(known['taxi_row'], known['taxi_col'], passenger, 0)

    def step(self) -> None:
        """Take the best step, and see that it is taken."""
        before = re.search(r'start (\d+), step (\d+)', self.window.text())
        action = TAXI.actions[self.option.optimal_actions(self.state())[0]]
        self.act(action.key, action.name)
        number = int(before.group(2)) + 1 if before else 1
        self.window.see(f', step {number} ')

    def run(self) -> None:
        """Have the machine run the option, from a start where it can begin."""
        window, ended = self.window, f'{PICKUP}: '
        while ended not in window.text():
            window.see('run it from here')
            self.act('n', 'new start')
            window.until(lambda: 'cannot start' not in window.text(), 'another start')
            self.act('enter', 'run it from here')
            window.until(
                lambda: 'cannot start' in window.text() or ended in window.text(), 'a run'
            )

    def show(self, start: int) -> None:
        """Show the option from a start."""
        self.window.see(f'next: start {start} ')
        if not self.option.can_start(self.state()):
            self.act('n', 'not here')
            return
        while not self.option.ends(self.state()):
            self.step()
        self.act('enter', 'done')

    def judge(self) -> None:
        """Answer questions about runs, and take the exam: all runs are right."""
        buttons = {'y': 'yes', 'r': 'right', 'enter': 'begin the run'}
        asked = ''
        while 'This lesson is finished.' not in (found := self.window.text()):
            time.sleep(0.1)
            if (about := run_to_judge(found)) not in ('', asked):
                asked, key = about, key_for(about)
                self.act(key, buttons[key])


@pytest.fixture
def windows() -> Iterator[Callable[..., Window]]:
    """Opens windows, and closes them at the end."""
    opened: list[Window] = []

    def opening(*arguments: Any, **options: Any) -> Window:
        opened.append(Window(*arguments, **options))
        return opened[-1]

    yield opening
    for window in opened:
        window.driver.quit()


@pytest.fixture(scope='module')
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """Pages for Taxi that are served meanwhile."""
    with served(tmp_path_factory.mktemp('browser'), 'taxi', '--learn', 'goal') as pages:
        yield pages


@contextmanager
def served(folder: Path, domain: str, *options: object) -> Iterator[Served]:
    """Serve pages: their address, and the folder of the data."""
    with free_domain_id() as domain_id:
        arguments = ('teach', domain, '--browser', '--port', 0, '--seed', 3, *options)
        command = Command(
            [*arguments, '--linger', LINGER, '--out', folder / 'data'], folder, domain_id
        )
        address = re.compile(r'Open (\S+) in a browser')
        command.until(lambda: address.search(command.output), 'the address')
        found = address.search(command.output)
        assert found is not None
        yield Served(found.group(1), folder / 'data', command)
        command.send(signal.SIGINT)
        assert command.ended(60) == 0, command.errors
        assert command.output.endswith('stopped\n')


def severe(window: Window) -> list[Any]:
    """Return the errors in the log of the browser."""
    return [each for each in window.driver.get_log('browser') if each['level'] == 'SEVERE']


def key_to_screen(
    window: Window, count: int, there: str = Keys.ARROW_UP, back: str = Keys.ARROW_DOWN
) -> list[float]:
    """Press two keys in turn that both change the board; return the ms of each key, sorted."""
    window.press(*[back] * 4)  # in Taxi: to the lower edge, where no wall is above
    window.until(lambda: re.search(r'step ([4-9]|\d\d)', window.text()), 'the way there')
    window.driver.execute_script(MEASURE)
    for number in range(count):
        window.press(back if number % 2 else there)
        window.until(
            lambda seen=number: window.driver.execute_script(COUNT) > seen, f'step {number}', 5.0
        )
    waits = sorted(window.driver.execute_script('return window.waits'))
    median, late = statistics.median(waits), waits[int(0.99 * len(waits))]
    busy = f'{os.getloadavg()[0]:.1f} of {os.cpu_count()} cores'
    print(f'{len(waits)} keys: median {median:.0f} ms, p99 {late:.0f} ms; {busy}')
    return waits


def test_two_people_teach_by_keys_and_by_buttons_while_strangers_flood_the_server(
    server: Served, windows: Callable[..., Window]
) -> None:
    flood = Flood(urlsplit(server.address).port or 0, STRANGERS)
    people = [
        Person(windows(size), server.address, code, keys=size == DESKTOP)
        for code, size in (('anna', DESKTOP), ('ben', PHONE))
    ]
    try:
        flood.opened()
        for person in people:
            person.name_option()
        for start in range(1, 5):
            for person in people:
                person.show(start)
        for person in people:
            person.window.see('next: start 5 ')
            person.window.see('initiation')
        waits = key_to_screen(people[0].window, 10)
    finally:
        flood.close()
    assert statistics.median(waits) < 2 * MEDIAN
    assert len(server.command.errors) < 100_000
    assert '\x1b' not in server.command.errors
    people[0].act(Keys.ESCAPE, 'menu')
    people[0].window.see('This demonstration is discarded')
    people[0].act('enter', 'yes')
    people[1].act('', 'menu')
    for person in people:
        person.window.see('What next?')
        person.window.click('Run a taught option')
        person.window.click(PICKUP)
        person.run()
        person.window.click('menu')
        person.window.click('Quit')
        person.window.see('Everything taught is saved.')
        (bag,) = (server.data / person.code / 'bags').iterdir()
        shown = [d for d in read_demonstrations(open_bag(bag)) if d.option_name == PICKUP]
        assert [demonstration.participant for demonstration in shown] == 4 * [person.code]
        assert severe(person.window) == []


@pytest.mark.parametrize('keys', [True, False])
def test_an_exam_is_taken_by_keys_or_by_buttons(
    keys: bool, server: Served, windows: Callable[..., Window]
) -> None:
    window = windows(DESKTOP if keys else PHONE)
    person = Person(window, server.address, f'emma{keys:d}', keys=keys)
    person.name_option()
    start, found = 1, ''
    while not run_to_judge(found):
        if f'next: start {start} ' in found:
            person.show(start)
            start += 1
        found = window.text()
    person.judge()
    window.see('learned: 5 of 5 runs in the exam were right, so at least 57 % are')
    (bag,) = (server.data / person.code / 'bags').iterdir()
    runs = [d for d in read_demonstrations(open_bag(bag)) if d.exam]
    assert [run.right for run in runs] == 5 * [True]
    assert severe(window) == []


def test_closing_in_mid_demonstration_loses_nothing_that_was_finished(
    server: Served, windows: Callable[..., Window]
) -> None:
    person = Person(windows(PHONE), server.address, 'dora', keys=True)
    person.name_option(NASTY)
    person.show(1)
    person.window.see('next: start 2 ')
    person.window.press(Keys.ARROW_LEFT)
    person.window.see(', step 1 ')
    person.window.driver.get('about:blank')
    person.window.until(
        lambda: not any('/dora/' in line for line in server.command.running().values()),
        'the end of the graph',
    )
    again = Person(windows(DESKTOP), server.address, 'dora', keys=False)
    again.window.see('What next?')
    again.window.click('Continue teaching an option')
    again.window.see('Continue with which option?')
    assert NASTY in again.window.text()
    assert not again.window.driver.find_elements(By.CSS_SELECTOR, '[onclick]')
    again.window.click(NASTY)
    again.window.see('Enter shows start 2.')


def test_the_board_and_what_drives_fit_on_a_phone(
    server: Served, windows: Callable[..., Window]
) -> None:
    light, dark = windows(PHONE), windows(PHONE, dark=True)
    papers = []
    for number, window in enumerate((light, dark)):
        Person(window, server.address, f'finn{number}', keys=True)
        window.see('What next?')
        window.click('Drive freely')
        window.see('new start')
        for part in ('.board svg', '.pad', '.main', '.head'):
            box = window.driver.find_element(By.CSS_SELECTOR, part).rect
            assert box['x'] >= 0
            assert box['x'] + box['width'] <= PHONE[0]
            assert box['y'] + box['height'] <= PHONE[1]
        wide = window.driver.execute_script('return document.documentElement.scrollWidth')
        assert wide <= PHONE[0]
        papers.append(
            window.driver.execute_script('return getComputedStyle(document.body).backgroundColor')
        )
    assert papers[0] != papers[1]


def test_key_to_screen_is_quick_and_no_other_server_is_asked(
    server: Served, windows: Callable[..., Window]
) -> None:
    window = windows(DESKTOP)
    Person(window, server.address, 'gina', keys=True)
    window.see('What next?')
    window.click('Drive freely')
    window.see('new start')
    waits = key_to_screen(window, KEYS)
    assert statistics.median(waits) < MEDIAN
    asked = [
        message['params']['request']['url']
        for entry in window.driver.get_log('performance')
        if (message := json.loads(entry['message'])['message'])['method'] == REQUEST
    ]
    origin = server.address.rpartition('/')[0]
    assert asked
    assert [url for url in asked if not url.startswith((origin, 'data:', 'about:'))] == []
    assert severe(window) == []


def test_the_picture_of_an_environment_follows_each_key_and_fits(
    tmp_path: Path, windows: Callable[..., Window]
) -> None:
    with served(tmp_path, 'gymnasium:MiniGrid-DoorKey-8x8-v0') as pages:
        for size in (PHONE, DESKTOP):
            window = windows(size)
            window.driver.get(f'{pages.address}/hugo{size[0]}')
            window.see('What next?')
            window.click('Drive freely')
            window.see('new start')
            image = window.driver.find_element(By.CSS_SELECTOR, '.board img')
            assert 0 <= image.rect['x'] <= size[0] - image.rect['width']
            assert image.rect['y'] + image.rect['height'] <= size[1]
            assert 'key distance' in window.driver.find_element(By.CSS_SELECTOR, '.rows').text
        waits = key_to_screen(window, KEYS, Keys.ARROW_LEFT, Keys.ARROW_RIGHT)
        assert statistics.median(waits) < MEDIAN
        assert severe(window) == []
