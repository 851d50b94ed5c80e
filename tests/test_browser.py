"""Pages on the real graph, through their own protocol: a graph for each participant."""

import os
from pathlib import Path
import re
import signal
import socket

from graph_support.command import Command
from humanopts_env.domains.registry import make_domain
from humanopts_teach.bags.contents import read_demonstrations
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.cli import main
from humanopts_teach.commands import CommandError
from humanopts_teach.commands.browser import kept_token
import pytest
from teach_support.flood import PROMPT
from teach_support.page_client import PageClient

NAME = 'go <b>west</b>'
QUESTIONS = len(make_domain('taxi').features)
LINGER = 4  # s; a page comes back sooner on a busy machine too
pytestmark = pytest.mark.timeout(300)  # on a busy machine


class Served:
    """``humanopts teach taxi --browser``, and its pages."""

    def __init__(self, folder: Path, domain_id: int, *more: object) -> None:
        self.data = folder / 'data'
        arguments = ('--port', 0, '--learn', 'goal', '--linger', LINGER, '--out', self.data, *more)
        self.command = Command(('teach', 'taxi', '--browser', *arguments), folder, domain_id)
        self.command.until(lambda: 'Open ' in self.command.output, 'the address')
        self._pages: list[PageClient] = []

    def page(self, participant: str) -> PageClient:
        """Open the page of a participant."""
        found = re.search(r'Open (\S+)(/\S+) in a browser', self.command.output)
        assert found is not None
        self._pages.append(PageClient(found.group(1), f'{found.group(2)}/{participant}'))
        return self._pages[-1]

    def nodes(self, participant: str) -> list[str]:
        """Return the processes of a participant's nodes."""
        return [line for line in self.command.running().values() if f'/{participant}/' in line]

    def graphs(self) -> list[int]:
        """Return the processes that each keep a participant's graph."""
        running = self.command.running().items()
        return [number for number, line in running if 'commands.seat_graph' in line]

    def close(self) -> None:
        """Close all pages, and end whatever is left."""
        for page in self._pages:
            page.socket.disconnect()
        self.command.close()


def teach(page: PageClient) -> None:
    """Name an option, and begin its first demonstration."""
    page.until('panel', 'What next?')
    page.press('1')
    page.until('panel', 'What is the option called?')
    page.press('ctrl-u', *NAME, 'enter')
    for number in range(1, QUESTIONS + 1):
        page.until('panel', f'question {number} of {QUESTIONS}')
        page.press('y' if number < 3 else 'n')
    page.until('panel', 'Enter shows start 1.')
    page.press('enter')
    page.until('panel', 'next: start 1')


def test_people_teach_at_once_within_the_seats_and_nothing_that_was_finished_is_lost(
    tmp_path: Path, domain_id: int, short_lease: None
) -> None:
    served = Served(tmp_path, domain_id, '--seats', 2)
    try:
        _teach_at_once(served)
    finally:
        served.close()


def _teach_at_once(served: Served) -> None:
    anna, ben = served.page('anna'), served.page('ben')
    teach(anna)
    anna.press('left')
    anna.until('panel', 'start 1, step 1')
    assert NAME not in anna.shows('panel')  # it is escaped
    named = {'client_id': anna.query['client_id'], 'level': 'error', 'message': PROMPT}
    anna.socket.emit('log', named)
    anna.socket.emit('event', {'client_id': anna.query['client_id'], 'id': PROMPT, 'args': PROMPT})
    ben.until('panel', 'What next?')
    assert 'you drive' not in ben.shows('head')
    cleo = served.page('cleo')
    cleo.until('panel', 'You are number 1 in line')
    assert len(served.graphs()) == 2

    anna.socket.disconnect()
    anna = served.page('anna')  # in mid-demonstration
    anna.until('panel', 'start 1, step 1')
    anna.press('enter')
    anna.until('panel', '(1 shown')
    anna.until('panel', 'next: start 2')
    anna.press('left')
    anna.until('panel', 'start 2, step 1')
    assert served.nodes('anna')
    anna.socket.disconnect()
    cleo.until('panel', 'What next?')
    assert len(served.graphs()) == 2
    assert not served.nodes('anna')
    assert served.nodes('ben')
    (bag,) = (served.data / 'anna' / 'bags').iterdir()
    (shown,) = read_demonstrations(open_bag(bag))
    assert (shown.participant, shown.option_name) == ('anna', NAME)

    for graph in served.graphs():
        os.kill(graph, signal.SIGKILL)
    ben.until('panel', 'The game has ended: see the terminal where it runs.')
    served.command.until(lambda: not served.nodes('ben'), "the end of ben's nodes")
    (bag,) = (served.data / 'ben' / 'bags').iterdir()
    assert open_bag(bag).damage == ''
    served.command.send(signal.SIGINT)
    assert served.command.ended(60) == 0, served.command.errors
    served.command.gone(10)
    assert served.command.output.endswith('stopped\n')
    assert '\x1b' not in served.command.output + served.command.errors
    assert '\n[sudo]' not in served.command.errors


def test_a_port_that_is_taken_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(('127.0.0.1', 0)) as taken:
        port = taken.getsockname()[1]
        options = ['--browser', '--port', str(port), '--out', str(tmp_path / 'data')]
        assert main(['teach', 'taxi', *options]) == 2
    said = f'cannot serve at 127.0.0.1, port {port}: Address already in use; choose another'
    assert said in capsys.readouterr().err


def test_the_token_of_a_study_stays_and_only_its_owner_reads_it(tmp_path: Path) -> None:
    folder = tmp_path / 'study'
    token = kept_token(folder)
    assert re.fullmatch(r'[A-Za-z0-9_-]{16,}', token)
    assert kept_token(folder) == token
    assert (folder / 'token').stat().st_mode & 0o777 == 0o600
    for text in (b'', b'short', b'with/a/slash/and/more', b'\xff' * 20):
        (folder / 'token').write_bytes(text)
        with pytest.raises(CommandError, match='token'):
            kept_token(folder)
