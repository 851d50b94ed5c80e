"""Windows of Chromium, pages that are served, and the rules of axe for accessibility."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.resources import files
import os
from pathlib import Path
import re
import shutil
import signal
import time
from typing import Any

from graph_support.command import Command
from graph_support.live import free_domain_id
from graph_support.taxi_person import OPTIONS, state_shown, TAXI
from graph_support.terminal import key_for, run_to_judge
from humanopts_env.domains.taxi import TaxiState
import pytest
from selenium import webdriver
from selenium.common.exceptions import StaleElementReferenceException, WebDriverException
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys

DESKTOP, PHONE = (1280, 800), (390, 844)
PICKUP = 'go to passenger and pickup'
ARROWS = {
    'up': Keys.ARROW_UP,
    'down': Keys.ARROW_DOWN,
    'left': Keys.ARROW_LEFT,
    'right': Keys.ARROW_RIGHT,
}
LINGER = 4  # s
STALE = StaleElementReferenceException
LOOKS = [(size, dark) for size in (DESKTOP, PHONE) for dark in (False, True)]
PICTURES = os.environ.get('PICTURES', '')
AXE = files('axe_core_python').joinpath('axe.min.js').read_text('utf-8')
_SPOKEN_WHOLE = ('button', 'checkbox', 'heading', 'image', 'radio', 'StaticText')
_UNSPOKEN = ('InlineTextBox', 'RootWebArea', 'ListMarker')
READ = """
const heard = document.querySelector('.nicegui-content > .heard')?.innerText ?? '';
const text = document.body.innerText;
return text.slice(0, text.length - heard.length);
"""
FINDINGS = """
const done = arguments[arguments.length - 1];
axe.run(arguments[0] ? {} : {runOnly: ['color-contrast']}).then(found => done(found.violations.map(
  each => `${each.id}: ${each.help}: ${each.nodes.map(node => node.html).join(' ')}`)));
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

    def __init__(self, size: tuple[int, int], *, dark: bool = False, hosts: str = '') -> None:
        """Open a window; ``hosts`` are rules for names, where certificates are not checked."""
        program, driver = chromium()
        options = webdriver.ChromeOptions()
        options.binary_location = program
        for argument in ('--headless=new', '--no-sandbox', '--disable-gpu', '--hide-scrollbars'):
            options.add_argument(argument)
        if hosts:
            options.add_argument(f'--host-resolver-rules={hosts}')
            options.accept_insecure_certs = True
        options.set_capability('goog:loggingPrefs', {'performance': 'ALL', 'browser': 'ALL'})
        self.driver = webdriver.Chrome(options=options, service=Service(driver))
        self.size = size
        self.look(size, dark)

    def look(self, size: tuple[int, int], dark: bool) -> None:
        """Have a window of this size, and touch on a phone, in light or dark."""
        phone, (width, height) = size == PHONE, size
        self.command(
            'Emulation.setDeviceMetricsOverride',
            mobile=phone,
            width=width,
            height=height,
            deviceScaleFactor=1,
        )
        self.command('Emulation.setTouchEmulationEnabled', enabled=phone)
        scheme = {'name': 'prefers-color-scheme', 'value': 'dark' if dark else 'light'}
        self.command('Emulation.setEmulatedMedia', features=[scheme])

    def findings(self) -> list[str]:
        """Return what axe finds on this page, on a desktop and a phone, in light and dark."""
        found = []
        if not self.driver.execute_script('return !!window.axe'):
            self.driver.execute_script(AXE)
        for size, dark in LOOKS:
            self.look(size, dark)
            where = f'{size[0]}, {"dark" if dark else "light"}'
            all_rules = (size, dark) in ((DESKTOP, False), (PHONE, True))
            these = self.driver.execute_async_script(FINDINGS, all_rules)
            found += [f'{where}: {each}' for each in these]
        return found

    def spoken(self) -> list[str]:
        """Return what a screen reader reads: role and name of each node of the page."""
        nodes = self.command('Accessibility.getFullAXTree')['nodes']
        by_id, found = {node['nodeId']: node for node in nodes}, list[str]()

        def read(node: dict[str, Any]) -> None:
            role, name = (node.get(key, {}).get('value', '') for key in ('role', 'name'))
            if name.strip() and not node['ignored'] and role not in _UNSPOKEN:
                found.append(name.strip() if role == 'StaticText' else f'{role}: {name}')
            for child in node['childIds'] if role not in _SPOKEN_WHOLE else ():
                if child in by_id:
                    read(by_id[child])

        read(nodes[0])
        return found

    def command(self, name: str, **parameters: Any) -> Any:
        """Have Chromium do something."""
        return self.driver.execute_cdp_cmd(name, parameters)

    def text(self) -> str:
        """Return what can be read."""
        try:
            return ' '.join(str(self.driver.execute_script(READ)).split())
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

    def click(self, words: str, still: Callable[[], bool] = lambda: True) -> bool:
        """
        Press a button, by its words or its name.

        :param still: whether it is wanted; buttons also go by themselves.
        :return: whether it was pressed.
        """
        pressed = False

        def clicked() -> bool:
            for button in self.driver.find_elements(By.TAG_NAME, 'button'):
                try:
                    if words in button.text or words == button.get_attribute('title'):
                        if self.size == PHONE:
                            self.tap(button)
                        else:
                            button.click()
                        return True
                except STALE:
                    return False
            return False

        def done() -> bool:
            nonlocal pressed
            pressed = clicked()
            return pressed or not still()

        self.until(done, f'a button {words}')
        return pressed

    def tap(self, element: Any) -> None:
        """Touch an element for a moment."""
        script = 'arguments[0].scrollIntoView({block: "nearest"}); '
        script += 'return arguments[0].getBoundingClientRect().toJSON()'
        box = self.driver.execute_script(script, element)
        at = {'x': box['x'] + box['width'] / 2, 'y': box['y'] + box['height'] / 2}
        self.command('Input.dispatchTouchEvent', type='touchStart', touchPoints=[at])
        self.command('Input.dispatchTouchEvent', type='touchEnd', touchPoints=[])

    def write(self, text: str) -> None:
        """Type into the field of the page."""
        self.driver.find_element(
            By.CSS_SELECTOR, 'form.typed input, form.typed textarea'
        ).send_keys(text)


class Visit:
    """
    Looks at the pages of a person: what axe finds, and what a screen reader reads.

    With a folder ``PICTURES`` in the environment, it also takes pictures of each page.
    """

    def __init__(self, window: Window, name: str) -> None:
        self.window, self.name = window, name
        self.size = window.size
        self.findings, self.spoken = list[str](), list[str]()

    def look(self, page: str) -> None:
        """Look at the page that is shown."""
        window = self.window
        self.findings += [f'{page}: {each}' for each in window.findings()]
        if PICTURES:
            for size, dark in LOOKS:
                window.look(size, dark)
                mode = 'dark' if dark else 'light'
                path = f'{PICTURES}/{self.name}-{page}-{size[0]}-{mode}.png'
                window.driver.save_screenshot(path)
        window.look(self.size, dark=False)
        self.spoken += [f'--- {page}', *window.spoken()]
        root = window.driver.find_element(By.TAG_NAME, 'html')
        assert str(root.get_attribute('lang'))[:2] in ('en', 'de')
        assert window.driver.title not in ('', 'humanopts')

    def report(self) -> None:
        """Print what was read, and fail if there were findings."""
        print('\n'.join(self.spoken))
        assert not self.findings, '\n'.join(self.findings)


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
        self.option = OPTIONS[PICKUP]
        window.driver.get(f'{address}/{code}')

    def name_option(self, name: str = PICKUP) -> None:
        """Name the option and answer every question."""
        window = self.window
        window.see('What next?')
        self.act('enter', 'Teach a new option')
        window.see('What is the option called?')
        window.write(name)
        self.act('enter', 'OK')
        self.answer_questions()
        window.see('Enter shows start 1.')
        self.act('enter', 'begin')

    def answer_questions(self) -> None:
        """Say what the option depends on."""
        for number, feature in enumerate(TAXI.features, start=1):
            self.window.see(f'question {number} of {len(TAXI.features)}')
            yes = feature.name in self.option.features
            self.act('y' if yes else 'n', 'yes' if yes else 'no')

    def act(self, key: str, button: str, still: Callable[[], bool] = lambda: True) -> bool:
        """Press a key, or the button for it as long as it is wanted; return whether it was."""
        if self.keys:
            self.window.press({**ARROWS, 'enter': Keys.ENTER}.get(key, key))
            return True
        return self.window.click(button, still)

    def features(self) -> str:
        """Return the text of the features; empty while the page draws them anew."""
        try:
            found = self.window.driver.find_element(By.CLASS_NAME, 'features').text
            return ' '.join(found.split('\n'))
        except WebDriverException:
            return ''

    def state(self) -> TaxiState:
        """Return the state that is shown; what is hidden is anything."""
        return state_shown(self.features())

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
        asked = about = ''

        def still() -> bool:  # the next run also begins by itself
            return run_to_judge(self.window.text()) == about

        while 'This lesson is finished.' not in (found := self.window.text()):
            time.sleep(0.1)
            about = run_to_judge(found)
            if about not in ('', asked) and self.act(key := key_for(about), buttons[key], still):
                asked = about


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
def shared_window() -> Iterator[Window]:
    """A window for several tests."""
    window = Window(DESKTOP)
    yield window
    window.driver.quit()


@contextmanager
def served(folder: Path, domain: str, *options: object) -> Iterator[Served]:
    """Serve pages for a domain: their address, and the folder of the data."""
    own = ('--seed', 3, '--out', folder / 'data')
    with served_by(('teach', domain, '--browser', *own, *options), folder) as pages:
        yield pages


@contextmanager
def served_by(arguments: tuple[object, ...], folder: Path) -> Iterator[Served]:
    """Run a command that serves pages."""
    with free_domain_id() as domain_id:
        command = Command((*arguments, '--port', 0, '--linger', LINGER), folder, domain_id)
        address = re.compile(r'Open (\S+) in a browser')
        try:
            command.until(lambda: address.search(command.output), 'the address')
            (found,) = address.findall(command.output)
            yield Served(found, folder / 'data', command)
            command.send(signal.SIGINT)
            assert command.ended(60) == 0, command.errors
            assert command.output.endswith('stopped\n')
        finally:
            command.close()


def severe(window: Window) -> list[Any]:
    """Return the errors in the log of the browser."""
    return [each for each in window.driver.get_log('browser') if each['level'] == 'SEVERE']
