"""
Nodes as forks of one process that has imported their modules: the fork server of multiprocessing.

Importing takes about a second of processor time per node, forking a hundredth of that. Each fork
has its own environment and log and, unless it takes over the terminal, its own process group.
"""

import atexit
from collections.abc import Mapping, Sequence
from contextlib import suppress
import gc
from importlib import import_module
import multiprocessing
from multiprocessing import forkserver
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
import os
from pathlib import Path
import signal
import sys
import tempfile
import threading
import traceback
from typing import Any, NoReturn

from humanopts_env.domains.names import modules_of
from humanopts_ros.middleware import LAUNCHER_PID
from humanopts_teach.launching import LaunchError, MODULES, USUAL
from setproctitle import setproctitle

_SERVES = 'HUMANOPTS_FORK_SERVER_OF'  # pid of the launcher and domain, while the server starts
_LOOK_SECONDS = 0.1  # period of checks for the launcher during imports
_MAX_FOLDER = 60  # maximum length of a socket's folder; that of its path is 107
_context = multiprocessing.get_context('forkserver')


def prepare(domain: str = '') -> None:
    """
    Start the fork server, which imports modules in the background.

    :param domain: name of the domain that the nodes will load.
    :raises LaunchError: the server cannot start, for example without a writable temporary folder.
    """
    _context.set_forkserver_preload([__name__])
    os.environ[_SERVES] = f'{os.getpid()} {domain}'
    try:
        folder = tempfile.gettempdir()
        if len(folder) > _MAX_FOLDER:
            tempfile.tempdir = '/tmp'  # to keep the path of the socket short
        forkserver.ensure_running()
        tempfile.tempdir = folder
    except OSError as error:
        raise LaunchError(f'cannot start processes: {error.strerror or error}') from error
    finally:
        del os.environ[_SERVES]


def start(
    module: str,
    arguments: Sequence[str],
    environment: Mapping[str, str],
    log: Path,
    *,
    terminal: bool = False,
) -> BaseProcess:
    """
    Start a process that calls ``main`` of a module and ends with this process.

    :param log: file to append output to.
    :param terminal: whether to share this process's input, output and process group; then only
        errors go to the log.
    :raises OSError: the machine cannot start another process.
    """
    prepare()
    try:
        os.getcwd()
    except FileNotFoundError:  # the folder was removed
        os.chdir('/')
    shared = [Connection(os.dup(standard)) for standard in (0, 1) if terminal]
    group = os.getpgrp() if terminal else 0
    what = module, list(arguments), dict(environment), os.path.abspath(log), shared, group
    process = _context.Process(target=_run, args=what, daemon=True)
    process.start()
    for each in shared:
        each.close()
    return process


def _serve(domain: str) -> None:
    """Import the usual nodes and a domain in the fork server; exit if its launcher ends."""
    launch = os.getppid()

    def look(*_: object) -> None:
        if os.getppid() != launch:  # the command was refused or killed
            os._exit(0)

    signal.signal(signal.SIGALRM, look)
    signal.siginterrupt(signal.SIGALRM, False)
    signal.setitimer(signal.ITIMER_REAL, _LOOK_SECONDS, _LOOK_SECONDS)
    os.setpgid(0, 0)
    null = os.open(os.devnull, os.O_RDWR)
    for standard in (0, 1):
        os.dup2(null, standard)
    setproctitle('humanopts fork server')  # first: this overwrites the initial environment
    atexit.register(os._exit, 0)
    gc.disable()  # imports create no garbage, and are a tenth faster without collection
    for name in USUAL:
        import_module(MODULES[name])
    import_module('sklearn.tree')  # needed by learner and lesson in the first lesson
    with suppress(Exception):  # the nodes will report the error
        for module in modules_of(domain):
            import_module(module)
    gc.freeze()  # exclude shared objects from collection, which would copy their pages
    gc.enable()
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)


def _run(
    module: str,
    arguments: list[str],
    environment: dict[str, str],
    log: str,
    shared: 'list[Connection[Any, Any]]',
    group: int,
) -> NoReturn:
    """
    Run a module in a fork as in a new process.

    It ends without finalizing Python, which would copy the shared memory of its modules.

    :param shared: standard input and output of the terminal; otherwise empty.
    :param group: process group to join; 0: a new one.
    """
    os.setpgid(0, group)
    os.environ.clear()
    os.environ.update({**environment, LAUNCHER_PID: str(os.getppid())})
    try:
        output = os.open(log, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o666)
    except OSError:  # for example, the log was removed and the disk is full
        output = os.open(os.devnull, os.O_WRONLY)
    for standard in (1, 2):
        os.dup2(output, standard)
    for standard, each in enumerate(shared):
        os.dup2(each.fileno(), standard)
    if shared:
        sys.stdin = open(0, closefd=False)  # noqa: SIM115 - multiprocessing has closed it
    for stream in (sys.stdout, sys.stderr):
        stream.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    sys.argv = [module, *arguments]
    setproctitle(' '.join([sys.executable, '-m', *sys.argv]))
    threading.Thread(target=_end_with_launch, daemon=True).start()
    status = 1
    try:
        status = import_module(module).main()
    except BaseException:
        traceback.print_exc()
    finally:
        with suppress(OSError):  # a full disk
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(status)


def _end_with_launch() -> None:
    launch = multiprocessing.parent_process()
    assert launch is not None, 'it was started by another process'
    launch.join()
    os.kill(os.getpid(), signal.SIGTERM)


_launcher, _, _domain = os.environ.pop(_SERVES, '').partition(' ')
if _launcher == str(os.getppid()):
    _serve(_domain)
