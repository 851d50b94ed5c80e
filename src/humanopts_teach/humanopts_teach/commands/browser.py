"""``--browser``: a page for each participant, with a graph, or with the graphs of a study."""

import asyncio
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import AbstractAsyncContextManager, asynccontextmanager, suppress
from dataclasses import replace
from functools import partial
import json
import secrets
import socket
import sys
import traceback
from typing import Any

from humanopts_env.domains.names import is_robot
from humanopts_teach.browser.pages import serve
from humanopts_teach.browser.seats import (
    ConditionSeat,
    GameError,
    has_room,
    message,
    Press,
    Seat,
    Seats,
)
from humanopts_teach.command_line import PageOptions
from humanopts_teach.commands import catch_interrupts, CommandError
from humanopts_teach.commands.session import new_name, title
from humanopts_teach.commands.study_session import Farewell, Study, Turn
from humanopts_teach.dialogue.panel import ScreenView
from humanopts_teach.launching.place import only_launch
from humanopts_teach.launching.processes import processes, Setup
from humanopts_teach.launching.usage import memory_left, memory_of_children
from humanopts_teach.ros.browser_teleop import BrowserTeleopNode, TeleopThread
from humanopts_teach.study.record import StudyError

_SERVER = 'browser'  # name reserved by the server; graphs have namespaces seat_1, seat_2, ...
_TOKEN_BYTES = 12
_STOPPING_SECONDS = 40.0  # for the processes of a graph to end; each has less


OpenGame = Callable[[TeleopThread, Seat], AbstractAsyncContextManager[Press]]


def teach_in_browser(setup: Setup, pages: PageOptions, participant: str) -> int:
    """
    Serve pages until Ctrl-C; other parameters and errors as of ``_serve_seats``.

    :param setup: of each participant's graph, except for its folder and bag.
    :raises OccupiedError: another server uses the namespace.
    """
    if is_robot(setup.domain):
        if (pages.seats or 1) > 1:
            raise CommandError('a robot is taught by one person at a time: --seats 1')
        pages = replace(pages, seats=1)

    def open_game(thread: TeleopThread, seat: Seat) -> AbstractAsyncContextManager[Press]:
        own = replace(
            setup,
            directory=setup.directory / seat.participant,
            participant=seat.participant,
            ask_participant=False,
            bag_name=new_name('bags/teach'),
        )
        return _game(own, thread, seat)

    def known() -> list[str]:
        return [each.parent.name for each in setup.directory.glob('*/demonstrations')]

    with only_launch(setup.namespace, [_SERVER]):
        print(f'Each participant has a folder in {setup.directory}.')
        return _serve_seats(title(setup.domain), open_game, pages, participant, known)


def _serve_seats(
    name: str,
    open_game: OpenGame,
    pages: PageOptions,
    participant: str,
    known: Callable[[], Sequence[str]],
) -> int:
    """
    Serve pages, each with a seat, until Ctrl-C.

    :param name: of the game or the study.
    :param open_game: returns the game of a seat.
    :param participant: code to propose; empty: none.
    :param known: returns the codes of earlier participants.
    :raises CommandError: the address cannot be used.
    """
    listening, token = _listen(pages), secrets.token_urlsafe(_TOKEN_BYTES)
    host, port = _name(pages.host), listening.getsockname()[1]
    thread = TeleopThread()
    try:
        with catch_interrupts() as interrupts:
            fits = partial(_fits, pages)
            seats = Seats(name, partial(open_game, thread), pages.linger, fits, known)
            print(f'Open http://{host}:{port}/{token} in a browser; Ctrl-C stops everything.')
            sys.stdout.flush()
            hosts = (pages.host, *pages.allow_host)
            serving = serve(
                seats, listening, token, participant, lambda: interrupts.received, hosts
            )
            asyncio.run(serving, debug=False)
            interrupts.received = False  # it is handled
    finally:
        thread.stop()
    print('stopped')
    return 0


def _fits(pages: PageOptions, games: int) -> bool:
    """Return whether another game is allowed; each is a child of this process."""
    if pages.seats is not None and games >= pages.seats:
        return False
    return has_room(*memory_left(), memory_of_children(), games)


def _listen(pages: PageOptions) -> socket.socket:
    try:
        family = socket.AF_INET6 if ':' in pages.host else socket.AF_INET
        return socket.create_server((pages.host, pages.port), family=family)
    except OSError as error:
        why = str(error.strerror).partition(' (')[0]
        raise CommandError(
            f'cannot serve at {pages.host}, port {pages.port}: {why}; choose another --host '
            'or --port'
        ) from error


def _name(host: str) -> str:
    """Return the host of the URL; for all addresses of the machine, the outward one."""
    if host not in ('0.0.0.0', '::'):
        return f'[{host}]' if ':' in host else host
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(('192.0.2.1', 9))  # an example address; nothing is sent
        except OSError:
            return socket.gethostname()
        return str(probe.getsockname()[0])


@asynccontextmanager
async def _game(
    setup: Setup, thread: TeleopThread, seat: Seat | ConditionSeat
) -> AsyncIterator[Press]:
    """
    Run the graph of a seat, and the node through which its participant teaches.

    :param setup: of this participant; the graph has a namespace of its own within the setup's.
    """
    setup = replace(setup, namespace=f'{setup.namespace.rstrip("/")}/seat_{seat.number}')
    loop = asyncio.get_running_loop()
    (spec,) = [spec for spec in processes(setup) if spec.terminal]
    async with _graph(setup, seat):
        found: asyncio.Future[Any] = loop.create_future()

        def show(view: ScreenView, frame: int) -> None:
            loop.call_soon_threadsafe(seat.show, view, frame)

        def end() -> None:
            loop.call_soon_threadsafe(seat.end)

        thread.open(
            lambda: BrowserTeleopNode(setup.namespace, spec.parameters, show, end),
            lambda node: loop.call_soon_threadsafe(found.set_result, node),
        )
        node = await found
        if isinstance(node, Exception):
            raise GameError(f'The game cannot be joined: {node}')
        try:
            yield lambda keys, frame: thread.call(partial(node.press, keys, frame))
        finally:
            closed = asyncio.Event()
            thread.close(node, partial(loop.call_soon_threadsafe, closed.set))
            await closed.wait()


@asynccontextmanager
async def _graph(setup: Setup, seat: Seat | ConditionSeat) -> AsyncIterator[None]:
    """Run a graph in a process of its own; the seat ends with it."""
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, '-m', 'humanopts_teach.commands.seat_graph'),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        process_group=0,  # Ctrl-C reaches only this process
    )
    assert process.stdin is not None
    assert process.stdout is not None
    output = process.stdout
    process.stdin.write(f'{setup.to_json()}\n'.encode())

    async def said() -> str:
        """Return the next message of the process; empty: it is ready."""
        line = await output.readline()
        return str(json.loads(line)) if line else 'see the terminal where it runs'

    async def watch() -> None:
        seat.end(f'The game has ended: {await said()}. Everything taught is saved.')

    watching = None
    try:
        starting, leaving = asyncio.create_task(said()), asyncio.create_task(seat.over.wait())
        await asyncio.wait((starting, leaving), return_when=asyncio.FIRST_COMPLETED)
        leaving.cancel()
        if starting.done() and starting.result():
            raise GameError(f'The game cannot be started: {starting.result()}.')
        watching = asyncio.create_task(watch()) if starting.done() else starting
        yield
    finally:
        if watching is not None:
            watching.cancel()
        process.stdin.close()
        try:
            await asyncio.wait_for(process.wait(), _STOPPING_SECONDS)
        except TimeoutError:
            process.kill()
            await process.wait()


def study_in_browser(study: Study, pages: PageOptions, participant: str) -> int:
    """Serve pages of a study; other parameters and errors as of ``_serve_seats``."""
    study.warn()
    with only_launch(study.namespace, [_SERVER]):
        print(f'{study.plan.study}: everything is kept in {study.folder.path}.')
        turns, known = partial(_all_turns, study), study.folder.codes
        return _serve_seats(study.plan.study, turns, pages, participant, known)


@asynccontextmanager
async def _all_turns(study: Study, thread: TeleopThread, seat: Seat) -> AsyncIterator[Press]:
    """Run the games of all conditions, one after the other; the last one ends the seat."""
    press: Press = _nothing

    async def play() -> None:
        nonlocal press
        try:
            with study.enter(seat.participant) as participant:
                turn = study.next_turn(participant)
                while isinstance(turn, Turn):
                    condition = ConditionSeat(seat)
                    async with _game(turn.setup, thread, condition) as pressed:
                        press = pressed
                        await condition.over.wait()
                        press = _nothing
                        seat.show(message(seat.head, 'The next part is being prepared ...'), 0)
                    if condition.farewell:
                        turn = Farewell(condition.farewell)
                    else:
                        turn = study.next_turn(participant, turn)
            seat.end(turn.text)
        except (CommandError, GameError, StudyError, OSError) as error:
            seat.end(str(error))
        except Exception:  # the page must not wait for ever
            traceback.print_exc()
            seat.end('The study cannot go on: see the terminal where it runs.')

    playing = asyncio.create_task(play())
    try:
        yield lambda keys, frame: press(keys, frame)
    finally:
        playing.cancel()
        with suppress(asyncio.CancelledError):
            await playing


def _nothing(keys: list[str], frame: int) -> None:
    """Ignore keys between two conditions."""
