"""``--browser``: a page and a graph for each participant, or the graphs of a study."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import (
    AbstractAsyncContextManager,
    asynccontextmanager,
    AsyncExitStack,
    suppress,
)
from dataclasses import dataclass, field, replace
from functools import partial
import json
import os
from pathlib import Path
import re
import secrets
import socket
import sys
import traceback

from humanopts_env.domains.names import is_robot
from humanopts_ros.limits import one_line
from humanopts_teach.browser.pages import Entrance, serve
from humanopts_teach.browser.seats import (
    ConditionSeat,
    GameError,
    has_room,
    Press,
    Seat,
    Seats,
)
from humanopts_teach.command_line import PageOptions
from humanopts_teach.commands import catch_interrupts, CommandError
from humanopts_teach.commands.session import new_name, title
from humanopts_teach.commands.study_session import Study, Turn
from humanopts_teach.dialogue.consent import ConsentApp
from humanopts_teach.dialogue.panel import ScreenView
from humanopts_teach.dialogue.view import view
from humanopts_teach.language import N_
from humanopts_teach.launching.place import only_launch
from humanopts_teach.launching.processes import processes, Setup
from humanopts_teach.launching.usage import memory_left, memory_of_children
from humanopts_teach.ros.browser_teleop import BrowserTeleopNode, TeleopThread
from humanopts_teach.study.record import EndedError, StudyError

_SERVER = 'browser'  # name reserved by the server; graphs have namespaces seat_1, seat_2, ...
_TOKEN_BYTES = 12
_TOKEN_FILE = 'token'  # in the folder of a study
_CANNOT_GO_ON = N_(
    'The study cannot continue right now. What you have done is saved; please tell the person who '
    'invited you.'
)
_STOPPING_SECONDS = 40.0  # for all processes of a graph to end; each has less time


def _turns_to_start() -> asyncio.Semaphore:
    return asyncio.Semaphore(max(1, len(os.sched_getaffinity(0)) // 2))


@dataclass
class Games:
    """
    Resources shared by the games of all seats.

    :ivar thread: thread that runs their nodes.
    :ivar starting: limit on simultaneous graph starts: the pages need processor time, too.
    """

    thread: TeleopThread
    starting: asyncio.Semaphore = field(default_factory=_turns_to_start)


OpenGame = Callable[[Games, Seat], AbstractAsyncContextManager[Press]]


def teach_in_browser(setup: Setup, pages: PageOptions, participant: str) -> int:
    """
    Serve pages until Ctrl-C; see ``_serve_seats`` for other parameters and errors.

    :param setup: setup for each participant's graph, except for its folder and bag.
    :raises OccupiedError: another server uses the namespace.
    """
    if is_robot(setup.domain):
        if (pages.seats or 1) > 1:
            raise CommandError('a robot is taught by one person at a time: --seats 1')
        pages = replace(pages, seats=1)

    def open_game(games: Games, seat: Seat) -> AbstractAsyncContextManager[Press]:
        own = replace(
            setup,
            directory=setup.directory / seat.participant,
            participant=seat.participant,
            ask_participant=False,
            bag_name=new_name('bags/teach'),
            language=seat.language,
        )
        return _game(own, games, seat)

    def known() -> list[str]:
        return [each.parent.name for each in setup.directory.glob('*/demonstrations')]

    with only_launch(setup.namespace, [_SERVER]):
        print(f'Each participant has a folder in {setup.directory}.')
        token = secrets.token_urlsafe(_TOKEN_BYTES)
        entrance = Entrance(participant)
        return _serve_seats(title(setup.domain), open_game, pages, entrance, token, known)


def _serve_seats(
    name: str,
    open_game: OpenGame,
    pages: PageOptions,
    entrance: Entrance,
    token: str,
    known: Callable[[], Sequence[str]],
    arrive: Callable[[Seat], Awaitable[None]] | None = None,
) -> int:
    """
    Serve pages, each with a seat, until Ctrl-C.

    :param name: name of the game or the study.
    :param open_game: function that returns the game of a seat.
    :param token: first segment of the path of every page.
    :param known: function that returns the codes of earlier participants.
    :param arrive: function called before a participant waits for a game; it may end the seat.
    :raises CommandError: the address cannot be used.
    """
    listening = _listen(pages)
    host, port = _name(pages.host), listening.getsockname()[1]
    thread = TeleopThread()
    try:
        with catch_interrupts() as interrupts:
            fits = partial(_fits, pages)
            seats = Seats(
                name, partial(open_game, Games(thread)), pages.linger, fits, known, arrive
            )
            print(f'Open http://{host}:{port}/{token} in a browser; Ctrl-C stops everything.')
            for name in pages.allow_host:
                print(f'Through a reverse proxy: https://{name}/{token}')
            sys.stdout.flush()
            hosts = (pages.host, *pages.allow_host)
            serving = serve(seats, listening, token, entrance, lambda: interrupts.received, hosts)
            asyncio.run(serving, debug=False)
            interrupts.received = False  # the signal has been handled
    finally:
        thread.stop()
    print('stopped')
    return 0


def _fits(pages: PageOptions, games: int) -> bool:
    """Return whether another game is allowed; each game is a child of this process."""
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
    """Return the host of the URL; if all addresses are served, the outward one."""
    if host not in ('0.0.0.0', '::'):
        return f'[{host}]' if ':' in host else host
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(('192.0.2.1', 9))  # a documentation address; nothing is sent
        except OSError:
            return socket.gethostname()
        return str(probe.getsockname()[0])


@asynccontextmanager
async def _game(setup: Setup, games: Games, seat: Seat | ConditionSeat) -> AsyncIterator[Press]:
    """
    Run the graph of a seat, and the teleoperation node of its participant.

    :param setup: setup of this participant; the graph's own namespace is within the setup's.
    """
    setup = replace(setup, namespace=f'{setup.namespace.rstrip("/")}/seat_{seat.number}')
    async with AsyncExitStack() as game:
        async with games.starting:
            await game.enter_async_context(_graph(setup, seat))
            node = await game.enter_async_context(_node(setup, games.thread, seat))
        yield lambda keys, frame: games.thread.call(partial(node.press, keys, frame))


@asynccontextmanager
async def _node(
    setup: Setup, thread: TeleopThread, seat: Seat | ConditionSeat
) -> AsyncIterator[BrowserTeleopNode]:
    """Run the teleoperation node of a participant."""
    loop = asyncio.get_running_loop()
    (spec,) = [spec for spec in processes(setup) if spec.terminal]
    made: asyncio.Future[BrowserTeleopNode | Exception] = loop.create_future()

    def show(view: ScreenView, frame: int) -> None:
        loop.call_soon_threadsafe(seat.show, view, frame)

    def end() -> None:
        loop.call_soon_threadsafe(seat.end)

    thread.open(
        lambda: BrowserTeleopNode(setup.namespace, spec.parameters, show, end),
        lambda result: loop.call_soon_threadsafe(made.set_result, result),
    )
    try:
        node = await asyncio.shield(made)
        if isinstance(node, Exception):
            raise GameError(f'The game cannot be joined: {node}')
        yield node
    finally:
        node = await made  # the seat may have ended before it was made
        if not isinstance(node, Exception):
            closed = asyncio.Event()
            thread.close(node, partial(loop.call_soon_threadsafe, closed.set))
            await closed.wait()


@asynccontextmanager
async def _graph(setup: Setup, seat: Seat | ConditionSeat) -> AsyncIterator[None]:
    """Run a graph in a separate process; the seat ends when the graph does."""
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
        """Return the next message of the process; empty: the graph is ready."""
        line = await output.readline()
        return str(json.loads(line)) if line else 'see the terminal where it runs'

    async def watch() -> None:
        seat.end(f'The game has ended: {await said()}. Everything taught is saved.')

    watching = None
    try:
        starting, leaving = asyncio.create_task(said()), asyncio.create_task(seat.over.wait())
        try:
            await asyncio.wait((starting, leaving), return_when=asyncio.FIRST_COMPLETED)
        finally:
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
    """Serve pages of a study; see ``_serve_seats`` for other parameters and errors."""
    study.warn()
    plan, recruiting = study.plan, study.plan.recruiting
    entrance = Entrance(
        participant,
        plan.language,
        recruiting.code or '',
        recruiting.columns,
        study.folder.new_code,
    )
    agreed: dict[Seat, float | None] = {}
    turns, arrive = partial(_all_turns, study, agreed), partial(_arrive, study, agreed)
    with only_launch(study.namespace, [_SERVER]):
        print(f'{plan.study}: everything is kept in {study.folder.path}.')
        token, known = kept_token(study.folder.path), study.folder.codes
        return _serve_seats(plan.study, turns, pages, entrance, token, known, arrive)


def kept_token(folder: Path) -> str:
    """
    Return the token of a study, which never changes, since people receive its URLs.

    :raises CommandError: the file of the token cannot be used.
    """
    path = folder / _TOKEN_FILE
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not path.exists():
            path.touch(0o600)
            path.write_text(secrets.token_urlsafe(_TOKEN_BYTES), 'utf-8')
        token = path.read_text('utf-8').strip()
    except (OSError, UnicodeDecodeError) as error:
        raise CommandError(f'{path} cannot be used: {error}') from error
    if not re.fullmatch(r'[A-Za-z0-9_-]{16,}', token):
        raise CommandError(f'{path} does not hold a token; delete it to get a new one')
    return token


async def _arrive(study: Study, agreed: dict[Seat, float | None], seat: Seat) -> None:
    """
    Ask for consent before anything runs or is written; end the seat unless consent is given.

    :param agreed: receives the seat's consent time in s; None: not requested.
    """
    try:
        app = study.consent_app(seat.participant)
        if app is not None:
            app.language = seat.language
            await _converse(seat, app)
            if app.agreed is None:
                seat.end(N_('Nothing was saved.'))
            elif not app.agreed:
                seat.end(*study.declined())
        agreed[seat] = app.seconds if app is not None else None
    except Exception as error:
        _end_by(error, study, seat)


async def _converse(seat: Seat, app: ConsentApp) -> None:
    """Show the consent pages, without a graph, until a decision or the seat's end."""
    clock, decided = asyncio.get_running_loop().time, asyncio.Event()

    def press(keys: list[str], frame: int) -> None:
        app.advance(clock())  # update the display time of the page
        app.type(keys, frame)
        app.advance(clock())
        if app.ended or app.agreed is not None:
            decided.set()
        elif keys:
            draw()

    def draw() -> None:
        seat.show(view(app), app.drawn())

    app.advance(clock())
    seat.listen(press)
    draw()
    waiting = [asyncio.create_task(each.wait()) for each in (decided, seat.over)]
    await asyncio.wait(waiting, return_when=asyncio.FIRST_COMPLETED)
    for each in waiting:
        each.cancel()


@asynccontextmanager
async def _all_turns(
    study: Study, agreed: dict[Seat, float | None], games: Games, seat: Seat
) -> AsyncIterator[Press]:
    """Run the games of all conditions, one after the other; the last one ends the seat."""
    press: Press = _nothing

    async def play() -> None:
        nonlocal press
        client = await seat.window.client() if seat.window is not None else {}
        consent = agreed.pop(seat)
        try:
            with study.enter(seat.participant, consent_seconds=consent, **client) as participant:
                turn = study.next_turn(participant)
                while isinstance(turn, Turn):
                    condition = ConditionSeat(seat)
                    setup = replace(turn.setup, language=seat.language)
                    async with _game(setup, games, condition) as pressed:
                        press = pressed
                        await condition.over.wait()
                        press = _nothing
                        seat.show(seat.message(N_('The next part is being prepared ...')), 0)
                    if condition.farewell:
                        seat.end(condition.farewell)
                        return
                    turn = study.next_turn(participant, turn)
                done = participant.read()
                seat.end(turn.text, turn.url if done.over or done.excluded else None)
        except Exception as error:  # otherwise, the page would wait forever
            _end_by(error, study, seat)

    playing = asyncio.create_task(play())
    try:
        yield lambda keys, frame: press(keys, frame)
    finally:
        playing.cancel()
        with suppress(asyncio.CancelledError):
            await playing


def _end_by(error: Exception, study: Study, seat: Seat) -> None:
    """End a seat because of an error; print errors that concern only the researcher."""
    match error:
        case EndedError():
            seat.end(*study.farewell(error.record))
        case StudyError():
            seat.end(str(error), '')
        case CommandError() | GameError() | OSError():
            print(one_line(f'{seat.participant}: {error}'), file=sys.stderr, flush=True)
            seat.end(_CANNOT_GO_ON)
        case _:
            traceback.print_exception(error)
            seat.end(_CANNOT_GO_ON)


def _nothing(keys: list[str], frame: int) -> None:
    """Ignore keys between two conditions."""
