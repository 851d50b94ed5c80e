"""A client of the pages' own protocol, without a browser."""

import ast
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from html import unescape
import json
import re
import threading
import time
from typing import Any
from urllib.request import urlopen
import uuid

import socketio
from socketio.exceptions import BadNamespaceError

PATIENCE = 120.0  # s; two graphs that start at once take long on a busy machine


class PageClient:
    """Knows what each part of a page shows, and presses keys on it."""

    def __init__(self, address: str, path: str) -> None:
        with urlopen(f'{address}{path}') as response:
            self.page = response.read().decode()
        (text,) = re.findall(r'parseElements\(String\.raw`(.*?)`\)', self.page, re.DOTALL)
        self.elements: dict[str, Any] = json.loads(unescape(text))
        (self.prefix,) = re.findall(r'prefix: "(.*)"', self.page)
        (query,) = re.findall(r'query: (\{.*\}),', self.page)
        mine = {'tab_id': str(uuid.uuid4()), 'document_id': str(uuid.uuid4())}
        self.query = {**ast.literal_eval(query), **mine, 'implicit_handshake': 'true'}
        self.opened: list[str] = []
        self._newest: dict[str, int] = {}  # number of the last message about each element
        self._lock = threading.Lock()
        self.address = address
        self.socket = self.connect()

    def connect(self) -> socketio.Client:
        """Connect, as a page does when it was loaded, and after the network was gone."""
        connection = socketio.Client(reconnection=False)  # the test decides when
        connection.on('update', self._update)
        connection.on('run_javascript', partial(self._run, connection))
        connection.on('open', lambda message: self.opened.append(self.prefix + message['path']))
        asked = '&'.join(f'{name}={value}' for name, value in self.query.items())
        path = f'{self.prefix}/_nicegui_ws/socket.io'
        connection.connect(f'{self.address}?{asked}', socketio_path=path, wait_timeout=PATIENCE)
        return connection

    def __enter__(self) -> 'PageClient':
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.disconnect()

    def _update(self, changed: dict[str, Any]) -> None:
        """Take an update, unless a later one came first: each comes in a thread of its own."""
        number = changed.pop('_id')
        with self._lock:
            for name, new in changed.items():
                if isinstance(new, dict) and number >= self._newest.get(name, 0):
                    self.elements[name], self._newest[name] = new, number

    def _run(self, connection: socketio.Client, asked: dict[str, Any]) -> None:
        if 'request_id' in asked:
            mine = {'client_id': self.query['client_id'], 'request_id': asked['request_id']}
            with suppress(BadNamespaceError):  # it disconnects just now
                connection.emit('javascript_response', {**mine, 'result': 0})

    def shows(self, part: str) -> str:
        """Return the HTML of a part."""
        found = [e for e in list(self.elements.values()) if part in e.get('class', [])]
        return str(found[0]['props'].get('innerHTML', ''))

    def press(self, *keys: object, frame: object = None) -> None:
        """Send what ``page.js`` sends: keys, or that the frame is displayed."""
        (number, heard) = next(
            (number, event)
            for number, element in self.elements.items()
            for event in element.get('events', [])
            if event['type'] == 'press'
        )
        on = int(self.shows('frame')) if frame is None else frame
        args = [json.dumps({'keys': keys, 'frame': on})]
        named = {'id': int(number), 'client_id': self.query['client_id']}
        self.socket.emit('event', {**named, 'listener_id': heard['listener_id'], 'args': args})

    def until(self, part: str, words: str) -> None:
        """Wait until a part shows something, and report it as displayed."""
        self.wait(lambda: words in self.shows(part), f'{words} in {part}')
        self.press()

    def wait(self, condition: Callable[[], bool], what: str) -> None:
        """Wait for a condition."""
        deadline = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < deadline, f'no {what}: {self.shows("panel")}'
            time.sleep(0.005)
