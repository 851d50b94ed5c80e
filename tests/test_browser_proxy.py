"""A lesson over HTTPS, through nginx with the configuration of the documentation."""

from collections.abc import Callable, Iterator
import json
from pathlib import Path
import re
import shutil
import socket
import subprocess
import time
from urllib.parse import urlsplit

import pytest
from selenium.webdriver.common.keys import Keys
from teach_support.chromium import DESKTOP, served, severe, Window, windows

pytestmark = [pytest.mark.chromium, pytest.mark.live, pytest.mark.timeout(300)]
__all__ = ['windows']
NAME = 'lab.example.org'
PAGE = Path(__file__).parents[1] / 'docs/how-to/invite-participants.md'


def free_port() -> int:
    """Return a port that is free just now."""
    with socket.create_server(('127.0.0.1', 0)) as found:
        return int(found.getsockname()[1])


@pytest.fixture
def proxy(tmp_path: Path) -> Iterator[Callable[[int], int]]:
    """Starts nginx before a port, and returns its own."""
    started: list[subprocess.Popen[bytes]] = []

    def start(port: int) -> int:
        nginx = shutil.which('nginx', path='/usr/sbin:/usr/bin')
        if nginx is None:
            pytest.fail('this test needs nginx: sudo apt install nginx-light')
        own = free_port()
        (server,) = re.findall(r'```nginx\n(.*?)```', PAGE.read_text(), re.DOTALL)
        for written, here in (
            ('443', str(own)),
            ('127.0.0.1:8080', f'127.0.0.1:{port}'),
            (f'/etc/letsencrypt/live/{NAME}', str(tmp_path)),
        ):
            assert written in server
            server = server.replace(written, here)
        request = f'openssl req -x509 -newkey rsa:2048 -nodes -days 1 -subj /CN={NAME}'
        files = '-keyout', f'{tmp_path}/privkey.pem', '-out', f'{tmp_path}/fullchain.pem'
        subprocess.run([*request.split(), *files], check=True, capture_output=True)
        folders = ('client_body', 'proxy', 'fastcgi', 'uwsgi', 'scgi')
        paths = ''.join(f'{name}_temp_path {tmp_path}/{name};' for name in folders)
        (tmp_path / 'nginx.conf').write_text(
            f'daemon off; pid {tmp_path}/pid; error_log stderr; events {{}}\n'
            f'http {{ access_log off; {paths}\n{server} }}\n'
        )
        command = [nginx, '-p', tmp_path, '-c', tmp_path / 'nginx.conf', '-e', 'stderr']
        started.append(subprocess.Popen(command))
        deadline = time.monotonic() + 20
        while socket.socket().connect_ex(('127.0.0.1', own)):
            assert time.monotonic() < deadline
            assert started[0].poll() is None
            time.sleep(0.05)
        return own

    yield start
    for each in started:
        each.terminate()
        each.wait()


def test_a_lesson_over_https_through_the_proxy_of_the_documentation(
    tmp_path: Path, windows: Callable[..., Window], proxy: Callable[[int], int]
) -> None:
    with served(tmp_path, 'taxi', '--allow-host', NAME) as pages:
        address = urlsplit(pages.address)
        site = f'https://{NAME}:{proxy(address.port or 0)}'
        window = windows(DESKTOP, hosts=f'MAP {NAME} 127.0.0.1')
        window.driver.get(site + address.path)
        window.see('Who is teaching?')
        window.press('anna', Keys.ENTER)
        window.see('What next?')
        window.click('Drive freely')
        window.see('new start')
        window.press(Keys.ARROW_UP)
        window.until(lambda: 'step 1' in window.text(), 'the first step')
        entries = window.driver.get_log('performance')
        messages = [json.loads(entry['message'])['message'] for entry in entries]
        sockets = [m['params']['url'] for m in messages if m['method'].endswith('SocketCreated')]
        assert sockets
        assert all(url.startswith(site.replace('https', 'wss')) for url in sockets)
        assert severe(window) == []
        window.driver.get(f'{site}/wrong')
        window.see('This address is incomplete.')
