"""A study in Chromium whose network is lost for a day, or whose disk is full."""

from collections.abc import Callable, Iterator
from contextlib import suppress
import json
from pathlib import Path
import resource
import socket
import threading
import time
from urllib.parse import urlsplit

from humanopts_teach.study.record import StudyFolder
import pytest
from selenium.webdriver.common.keys import Keys
from teach_support.chromium import DESKTOP, PHONE, Served, served_by, Window, windows

pytestmark = [pytest.mark.chromium, pytest.mark.live, pytest.mark.timeout(300)]
__all__ = ['windows']
DAY = 25 * 3600.0  # s, longer than a place is held
BUTTON = 'fetch'
FULL = 500  # bytes; a file cannot become larger, and the plan is
PLAN = {
    'study': 'faults',
    'participants': 1,
    'reading': 0,
    'consent': 'consent.md',
    'conditions': [
        {'name': 'goal', 'domain': 'rooms', 'learn': 'goal', 'teach': 9, 'teach_buttons': [BUTTON]}
    ],
}


class Cable:
    """The network between a browser and a server."""

    def __init__(self, address: str) -> None:
        self._server = urlsplit(address).port
        self._listening = socket.create_server(('127.0.0.1', 0))
        port = self._listening.getsockname()[1]
        self.address = address.replace(f':{self._server}/', f':{port}/')
        self._ends: list[socket.socket] = []
        self._lost = False
        threading.Thread(target=self._accept, daemon=True).start()

    def lose(self) -> None:
        """Carry nothing from now on; the ends are not told."""
        self._lost = True

    def mend(self) -> None:
        """Carry new connections; the old ones are no longer known."""
        for end in self._ends:
            end.close()
        self._ends, self._lost = [], False

    def close(self) -> None:
        """End all connections."""
        self._listening.close()
        self.mend()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                browser, _ = self._listening.accept()
                if self._lost:
                    browser.close()
                    continue
                server = socket.create_connection(('127.0.0.1', self._server))
                self._ends += [browser, server]
                for ends in ((browser, server), (server, browser)):
                    threading.Thread(target=self._carry, args=ends, daemon=True).start()

    def _carry(self, sender: socket.socket, receiver: socket.socket) -> None:
        with suppress(OSError):
            while data := sender.recv(65536):
                if not self._lost:
                    receiver.sendall(data)
            receiver.shutdown(socket.SHUT_WR)


@pytest.fixture
def study(tmp_path: Path) -> Iterator[tuple[Served, StudyFolder]]:
    """A study with one place that is served meanwhile, and its folder."""
    (tmp_path / 'plan.yaml').write_text(json.dumps(PLAN))
    (tmp_path / 'consent.md').write_text('# Taking part\n')
    plan, data = tmp_path / 'plan.yaml', tmp_path / 'data'
    arguments = ('study', plan, '--study', data, '--browser', '--seats', 1)
    with served_by(arguments, tmp_path) as pages:
        yield pages, StudyFolder(data)


def agree(window: Window, words: str = 'I agree to take part') -> None:
    """Take part."""
    window.see('Taking part')
    time.sleep(0.5)
    window.click(words)


def test_a_participant_whose_network_is_lost_for_a_day_continues_without_a_key(
    study: tuple[Served, StudyFolder], windows: Callable[..., Window]
) -> None:
    pages, folder = study
    cable = Cable(pages.address)
    anna, ben = windows(PHONE), windows(DESKTOP)
    anna.driver.get(f'{cable.address}/anna')
    agree(anna)
    anna.see('What next?')
    anna.click(BUTTON)
    for number in (1, 2):
        anna.see(f'question {number} of')
        anna.click('yes')
    anna.see('question 3 of')
    anna.click('no to all others')
    anna.see('Enter shows start 1.')
    anna.click('begin')
    anna.see('next: start 1')
    anna.press(Keys.ARROW_DOWN)
    anna.see('start 1, step 1')
    anna.press(Keys.ENTER)
    anna.see('next: start 2')
    assert '1 shown' in anna.text()
    anna.press(Keys.ARROW_DOWN)
    anna.see('start 2, step 1')
    cable.lose()
    notice = anna.driver.find_element('id', 'popup')
    anna.until(lambda: 'Connection lost.' in notice.text, 'the notice')

    def left() -> bool:
        return bool(folder.records()[0][0].of('part left')) and not folder.running()

    pages.command.until(left, 'the end of the seat')
    (record,) = folder.records()[0]
    events = [json.loads(line) for line in record.path.read_text('utf-8').splitlines()]
    earlier = [event | {'time': event['time'] - DAY} for event in events]
    record.path.write_text(''.join(f'{json.dumps(event)}\n' for event in earlier), 'utf-8')
    ben.driver.get(f'{pages.address}/ben')  # who takes the place of anna
    agree(ben)
    ben.see('What next?')
    ben.driver.get('about:blank')
    cable.mend()
    anna.see('What next?')  # the page has loaded itself again
    assert 'Welcome back' in anna.text()
    anna.click(BUTTON)
    anna.see('Enter shows start 2.')
    assert '1 shown' in anna.text()
    assert [each.place for each in folder.records()[0]] == [0, 0]
    assert pages.command.errors == ''
    cable.close()


def test_a_disk_that_is_full_at_the_consent_is_explained_and_leaves_the_place_free(
    study: tuple[Served, StudyFolder], windows: Callable[..., Window]
) -> None:
    pages, folder = study
    before = sorted(folder.path.rglob('*'))
    server = pages.command.pid
    soft, hard = resource.prlimit(server, resource.RLIMIT_FSIZE)
    resource.prlimit(server, resource.RLIMIT_FSIZE, (FULL, hard))
    window = windows(DESKTOP)
    window.driver.get(f'{pages.address}/anna?lang=de')
    agree(window, 'Ich bin einverstanden')
    window.see('Die Studie kann gerade nicht beginnen, und es wurde nichts gespeichert.')
    assert window.findings() == []
    (line,) = pages.command.errors.splitlines()
    assert line.startswith('humanopts study: anna could not begin, and nothing was saved: ')
    assert {*folder.path.rglob('*')} - {*before} <= {folder.path / '.lock'}
    resource.prlimit(server, resource.RLIMIT_FSIZE, (soft, hard))
    window.driver.get(f'{pages.address}/ben')
    agree(window)
    window.see('What next?')
    (record,) = folder.records()[0]
    assert (record.code, record.number, record.place) == ('ben', 0, 0)
