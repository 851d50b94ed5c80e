"""A launch for the length of one command: what is asked for, checked, and the graph that runs."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field, replace
import os
from pathlib import Path
import re
import sys
import tempfile
import time
from typing import Any

from humanopts_env.domains.base import Domain, DomainError
from humanopts_env.domains.capabilities import HasTeachingDefaults
from humanopts_env.domains.names import is_registered
from humanopts_env.domains.registry import make_domain, reference_options
from humanopts_learner.demonstrations import check_method
from humanopts_learner.options.judge import Thresholds
from humanopts_ros.limits import printable
from humanopts_ros.middleware import check_settings
from humanopts_ros.recording import Selection
from humanopts_teach.bags.writer import parts
from humanopts_teach.commands import CommandError, Interrupts, noticed_interrupts, refusing
from humanopts_teach.commands.options import LaunchOptions
from humanopts_teach.commands.output import unfailing_output
from humanopts_teach.launching import LaunchError, USUAL
from humanopts_teach.launching.job import front_is_gone
from humanopts_teach.launching.launcher import Launcher
from humanopts_teach.launching.place import only_launch
from humanopts_teach.launching.processes import (
    common_parameters,
    processes,
    RECORDER,
    Recording,
    Setup,
    UnknownNodeError,
)
from humanopts_teach.launching.restarts import MOST, NodeExit
from humanopts_teach.ros.graph_client import GraphClient
from humanopts_teach.ros.graph_probe import check_free

_NAMESPACE = re.compile(r'/|(/[A-Za-z_][A-Za-z0-9_]*)+')  # of nodes, as ROS 2 allows them
_TEACHING_SECONDS = 600.0  # longest time in which the simulated teacher does nothing
WATCHED = 0.15  # s between steps of the machine, while a person looks on
NEWS_SECONDS = 10.0  # for what was published to come here


def setup_from(
    domain: str, launch: LaunchOptions, *, evaluated: bool = False, **own: Any
) -> Setup:
    """
    Return the setup that the options of a launch ask for.

    :param evaluated: the command needs a bag that can be evaluated.
    :param own: fields that the command sets itself; ``directory`` and ``step_period`` where the
        user gives none.
    :raises CommandError: the domain, its parameters or its thresholds are not valid, the namespace
        cannot be used, the bag would not hold what an evaluation needs, or a node that is to run
        here is none of the launch.
    """
    check_place(launch.namespace)
    parameters = dict(launch.parameter)
    usual = Thresholds()
    given = {name: getattr(launch, name) for name in asdict(usual)}
    with refusing(ValueError):
        only = own.get('only', ())
        if is_registered(domain) or not only or 'game' in only:  # else it is another node's
            check_method(launch.learn, make_domain(domain, parameters))
        thresholds = replace(usual, **{n: v for n, v in given.items() if v is not None})
    if own.get('record', True):
        own['recording'] = _recording(launch, evaluated)
    if launch.step_period is not None:
        own['step_period'] = launch.step_period
    folder = launch.out or own.pop('directory', default_folder(domain))
    setup = Setup(
        domain=domain,
        **{**own, 'directory': Path(os.path.abspath(folder))},
        domain_parameters=parameters,
        seed=launch.seed,
        strategy=launch.strategy,
        learn=launch.learn,
        diagnostics=launch.diagnostics,
        views=launch.views,
        budget=launch.budget,
        thresholds=thresholds,
    )
    with refusing(UnknownNodeError, what='--only: '):
        processes(setup)
    return setup


def _recording(launch: LaunchOptions, evaluated: bool) -> Recording:
    """Return what goes into the bag; warn, or refuse, where it could not be evaluated."""
    topics, exclude = tuple(launch.record), tuple(launch.record_exclude)
    if lacking := Selection(launch.namespace, topics, exclude).unevaluable:
        if evaluated:
            raise CommandError(lacking)
        print(f'humanopts: {lacking}', file=sys.stderr)
    return Recording(topics, exclude, launch.split_bytes or 0, launch.split_seconds or 0.0)


def new_name(prefix: str) -> str:
    """Return a name that sorts by time and was not used before this second."""
    return time.strftime(f'{prefix}-%Y%m%d-%H%M%S')


def default_folder(domain: str) -> Path:
    """Return where the data of a domain goes: its name, with no character that paths dislike."""
    return Path('runs') / re.sub(r'[^\w.-]+', '-', domain)


def check_place(namespace: str) -> None:
    """
    Check where nodes are to run, or run.

    :raises CommandError: the namespace cannot be used.
    :raises MiddlewareError: ROS cannot start with the settings of the shell.
    """
    if not _NAMESPACE.fullmatch(namespace):
        raise CommandError(f'{namespace!r} is not a namespace; one reads / or /room_1/left')
    check_settings(thorough=True)


@dataclass(frozen=True)
class Session:
    """The processes of a launch and the node that conducts them."""

    setup: Setup
    launcher: Launcher
    graph: GraphClient
    interrupts: Interrupts
    unclean: list[str] = field(default_factory=list)  # nodes that failed at their end, in words

    @property
    def bags(self) -> list[Path]:
        """The bags of the session: one, and another for each time that the recorder ended."""
        return parts(self.setup.bag) or [self.setup.bag]

    def check(self, *besides: str) -> None:
        """
        Look after the processes, and whether the session is to end.

        :param besides: as of ``Launcher.check``.
        :raises LaunchError: a node ended, and is not started again.
        :raises KeyboardInterrupt: SIGINT, SIGTERM or SIGHUP has come.
        """
        self.interrupts.check()
        self.launcher.check(*besides)

    def stay(
        self, report: Callable[[str], None], watch: Callable[[], object] = lambda: None
    ) -> None:
        """
        Stay until the session is to end.

        :param report: called with each line that a node says of itself.
        :param watch: called again and again, for what the command looks after besides.
        :raises LaunchError: a node ended, and is not started again, or not all was recorded.
        :raises KeyboardInterrupt: the session is to end, and all was recorded.
        """

        def check() -> None:
            watch()
            self.check(RECORDER)

        try:
            self.graph.stay(check, report)
        except KeyboardInterrupt:
            self.check_recording()
            raise

    def watch_terminal(self) -> None:
        """
        Take a message of the graph, once there is one, and look for an interrupt.

        :raises KeyboardInterrupt: one has come.
        """
        self.graph.take(0.1)
        self.interrupts.check()
        if front_is_gone():
            raise KeyboardInterrupt

    def check_recording(self) -> None:
        """
        Check at the end of a session that everything was recorded, as far as is known.

        :raises LaunchError: the recorder died, or has stopped; the text says why.
        """
        self.launcher.check()
        if unrecorded := self.graph.unrecorded():
            raise LaunchError(unrecorded)

    def restarts(self) -> list[str]:
        """Return a sentence for each node that was started again, and for gaps in the bags."""
        counts = Counter((end.node, end.how) for end in self.launcher.ends if end.again)
        said = [
            f'the node {node} ended {"once" if count == 1 else f"{count} times"} ({how}) and was '
            'started again'
            for (node, how), count in sorted(counts.items())
        ]
        if len(self.bags) > 1:
            names = ', '.join(map(str, self.bags))
            said.append(f'the recording is in several bags, and has gaps between them: {names}')
        return said

    def end(self) -> int:
        """Report the problems of a session that has ended; return its exit status."""
        restarts = self.restarts()
        for line in restarts:
            print_line(line)
        return 1 if restarts or self.unclean else 0


def taught_options(domain: Domain[Any]) -> tuple[str, ...]:
    """Return what the simulated teacher teaches: all that it knows, or what the domain says."""
    with refusing(DomainError):
        known = tuple(reference_options(domain))
    if not known:
        raise CommandError(
            f'{domain.name} has no reference options, which the simulated teacher needs; '
            f'teach it yourself: humanopts teach {domain.name}'
        )
    usual = domain.teaching.options if isinstance(domain, HasTeachingDefaults) else ()
    return usual or known


def wait_until_taught(running: Session) -> None:
    """
    Wait until the simulated teacher has finished, and what was learned of it has come here.

    :raises LaunchError: it does not go on, or a node died.
    """
    graph, setup = running.graph, running.setup
    seconds = _TEACHING_SECONDS + setup.step_period
    graph.wait(graph.teacher_finished, seconds, 'the simulated teacher', graph.taught_so_far)
    last = setup.taught[-1]
    graph.wait(lambda: graph.knows_learned(last), NEWS_SECONDS, f'what was learned of {last!r}')


def check_folder(setup: Setup, *, new: bool = False) -> None:
    """
    Refuse an output folder that cannot be used.

    :param new: it must be empty or not there.
    :raises CommandError: it cannot be used; the text says why.
    """
    folder = setup.directory
    try:
        str(folder).encode()  # parameters and the bag name it
    except UnicodeEncodeError:
        raise CommandError(f'{folder} is not in UTF-8; choose another --out') from None
    with refusing(OSError, what=f'cannot write in {folder}: '):
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
            with suppress(OSError):  # another process put a file there
                for path in made:  # a launch that is refused leaves nothing
                    path.rmdir()


def print_line(line: str) -> None:
    """Print a line of the command on standard error, at once."""
    print(printable(f'humanopts: {line}'), file=sys.stderr, flush=True)


@contextmanager
def place(namespace: str, names: Sequence[str] = USUAL) -> Iterator[None]:
    """
    Hold the places of nodes that nobody runs yet.

    :raises OccupiedError: some of them run already.
    """
    with only_launch(namespace, names):
        check_free(namespace, names)
        yield


@contextmanager
def session(
    setup: Setup,
    namespace: str,
    progress: Callable[[GraphClient], None] = lambda _: None,
    report: Callable[[str], object] = print_line,
    restarts: int = MOST,
    *,
    new: bool = False,
) -> Iterator[Session]:
    """
    Launch a graph, wait until it is ready, and stop it whatever happens, the recorder last.

    A node that ends meanwhile is started again; reported here, on the graph, in its log.
    Nothing is written until no other launch is known to run these nodes.

    :param progress: called about twenty times a second during a wait.
    :param restarts: times in a row that a node is started again.
    :param report: called with a line about a node that ended, was stopped or goes on.
    :param new: the output folder must be empty or not there.
    :raises OccupiedError: nodes of the launch run already, or another launch has the folder.
    :raises CommandError: the output folder cannot be used.
    :raises LaunchError: a node ended and is not started again, or does not become ready.
    :raises KeyboardInterrupt: SIGINT, SIGTERM or SIGHUP has come; everything is stopped.
    """
    specs, logs = processes(setup), setup.directory / 'log'
    launcher = Launcher(specs, logs, namespace, restarts=restarts)

    def watch() -> None:
        interrupts.check()
        launcher.check()
        progress(graph)

    names = [spec.name for spec in specs if not spec.terminal]
    with unfailing_output(), place(namespace, names), noticed_interrupts() as interrupts:
        check_folder(setup, new=new)
        interrupts.check()
        graph = GraphClient(namespace, common_parameters(setup), setup.bag, watch=watch)
        running = Session(setup, launcher, graph, interrupts)

        def on_end(end: NodeExit, instance: str) -> None:
            graph.note_end(end, instance)
            if end.again:  # the other is an error of the session
                report(end.text)

        launcher.on_start, launcher.on_end = graph.note_start, on_end
        launcher.report = graph.report = report
        try:
            for late in (False, True):
                launcher.start(late=late)
                graph.wait_ready(launcher.node_names)
            graph.starting = False
            yield running
        finally:
            try:
                graph.close()
            finally:
                running.unclean.extend(launcher.stop())
                for problem in running.unclean:
                    report(problem)


def run_in_terminal(
    setup: Setup, namespace: str, done: Callable[[Session], object] = lambda running: None
) -> tuple[Session, int]:
    """
    Launch a graph, give the terminal to the person, and stop everything.

    :param done: called when the terminal is free again, before the recording is checked.
    :return: the session that has ended, and the exit status of the terminal's node.
    :raises LaunchError: as of ``session``, or not all was recorded.
    """
    print('starting ...', flush=True)
    said: list[str] = []  # while the terminal is not ours
    try:
        with session(setup, namespace, report=said.append) as running:
            status = running.launcher.run_terminal(running.watch_terminal)
            done(running)
            running.graph.catch_up()
            running.check_recording()
    finally:
        for line in said:
            print_line(line)
    return running, status
