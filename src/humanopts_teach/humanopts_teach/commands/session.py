"""A launched graph for the length of one command."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
import signal
import sys
import tempfile

from humanopts_env.domains.base import DomainError
from humanopts_env.domains.registry import make_domain
from humanopts_teach.commands.errors import CommandError
from humanopts_teach.commands.signals import ENDING, interruptible
from humanopts_teach.launching.launcher import Launcher, LaunchError
from humanopts_teach.launching.lock import only_launch
from humanopts_teach.launching.processes import common_parameters, processes, Setup
from humanopts_teach.ros.graph_client import GraphClient


@dataclass(frozen=True)
class Session:
    """The processes of a launch and the node that conducts them."""

    launcher: Launcher
    conductor: GraphClient
    unclean: list[str] = field(default_factory=list)  # what did not end as asked; known at the end

    def check_recording(self) -> None:
        """
        Look at the end of a sitting whether everything was recorded, as far as is known.

        :raises LaunchError: the recorder died, or has stopped; the text says why.
        """
        self.launcher.check()
        if unrecorded := self.conductor.unrecorded():
            raise LaunchError(unrecorded)


def check_setup(setup: Setup, *, new: bool = False) -> None:
    """
    Refuse a launch that cannot work, before anything is started.

    :param new: the output folder must be empty or not there.
    :raises CommandError: no such domain, or the output folder cannot be used.
    """
    try:
        make_domain(setup.domain, setup.domain_parameters)
        _check_folder(setup, new)
    except DomainError as error:
        raise CommandError(str(error)) from error
    except UnicodeEncodeError:
        raise CommandError(f'{setup.directory} is not in UTF-8; choose another --out') from None
    except OSError as error:
        raise CommandError(f'cannot write in {setup.directory}: {error.strerror}') from error


def _check_folder(setup: Setup, new: bool) -> None:
    folder = setup.directory
    str(folder).encode()  # parameters and the bag name it
    if new and folder.is_dir() and any(folder.iterdir()):
        raise CommandError(f'{folder} is not empty; choose another --out')
    if setup.record and setup.bag.exists():
        raise CommandError(f'{setup.bag} exists already; choose another folder')
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with tempfile.TemporaryFile(dir=folder) as probe:
            probe.write(bytes(4096))
            probe.flush()
    finally:
        with suppress(OSError):  # somebody else put something there
            for path in made:  # a launch that is refused leaves nothing
                path.rmdir()


@contextmanager
def session(
    setup: Setup, namespace: str, progress: Callable[[GraphClient], None] = lambda _: None
) -> Iterator[Session]:
    """
    Launch a graph, wait until it is ready, and stop it whatever happens, the recorder last.

    :param progress: called about twenty times a second while something is waited for.
    :raises LaunchError: a node died or does not become ready, or another launch is in the way.
    :raises KeyboardInterrupt: SIGINT, SIGTERM or SIGHUP; a second one is ignored while stopping.
    """
    launcher = Launcher(processes(setup), setup.directory / 'log', namespace)
    with only_launch(namespace), interruptible():
        conductor = _conduct(setup, namespace, launcher, progress)
        running = Session(launcher, conductor)
        try:
            for late in (False, True):
                launcher.start(late=late)
                conductor.wait_ready(launcher.node_names)
            yield running
        finally:
            for number in ENDING:
                signal.signal(number, signal.SIG_IGN)
            try:
                conductor.close()
            finally:
                running.unclean.extend(launcher.stop())
                for problem in running.unclean:
                    print(f'humanopts: {problem}', file=sys.stderr)


def _conduct(
    setup: Setup, namespace: str, launcher: Launcher, progress: Callable[[GraphClient], None]
) -> GraphClient:
    def watch() -> None:
        launcher.check()
        progress(conductor)

    conductor = GraphClient(namespace, common_parameters(setup), setup.bag, watch=watch)
    return conductor
