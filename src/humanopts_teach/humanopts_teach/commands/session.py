"""One launch during a command: its options, their checks, and the running graph."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
import os
from pathlib import Path
import re
import sys
import tempfile
import time
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.capabilities import HasTeachingDefaults
from humanopts_env.domains.described import simulated
from humanopts_env.domains.formulas import derive
from humanopts_env.domains.names import is_registered, is_robot, ROBOT, robot_file
from humanopts_env.domains.registry import open_domain, reference_options
from humanopts_learner.demonstrations import check_method
from humanopts_ros.limits import printable
from humanopts_ros.middleware import check_settings
from humanopts_ros.recording import Selection
from humanopts_teach.bags.writer import parts
from humanopts_teach.command_line import LaunchOptions
from humanopts_teach.commands import (
    catch_interrupts,
    CommandError,
    confirmed,
    Interrupts,
    refusing,
)
from humanopts_teach.commands.output import tolerant_output
from humanopts_teach.gamepad import Gamepad, read_mapping
from humanopts_teach.language import _
from humanopts_teach.launching import LaunchError, RECORDER, USUAL
from humanopts_teach.launching.job import shell_job_ended
from humanopts_teach.launching.launcher import Launcher
from humanopts_teach.launching.place import only_launch
from humanopts_teach.launching.processes import (
    common_parameters,
    node_names,
    processes,
    Setup,
)
from humanopts_teach.launching.restarts import MAX_RESTARTS, NodeExit
from humanopts_teach.lesson.store import similar_code
from humanopts_teach.ros.conductor import Conductor
from humanopts_teach.ros.graph_probe import check_free
from humanopts_teach.study.record import SimilarCodeError

_NAMESPACE = re.compile(r'/|(/[A-Za-z_][A-Za-z0-9_]*)+')  # valid namespace of a ROS 2 node
_TEACHING_SECONDS = 600.0  # s, maximum time without progress of the simulated teacher
WATCHED = 0.15  # s between the machine's steps while a person watches
ARRIVAL_SECONDS = 10.0  # for published messages to arrive


def setup_from(
    domain: str, launch: LaunchOptions, *, evaluated: bool = False, **own: Any
) -> Setup:
    """
    Return the setup described by the options of a launch.

    :param evaluated: whether the command evaluates the bag.
    :param own: fields of Setup set by the command; the user's choices override ``directory`` and
        ``step_period``.
    :raises CommandError: the domain, its parameters, a threshold, the namespace or a node name is
        invalid, or a bag to be evaluated would lack a topic.
    """
    check_place(launch.namespace)
    if is_robot(domain):
        path, kind = robot_file(domain)
        domain = ':'.join(filter(None, (f'{ROBOT}{path}', kind)))
    given = {name: value for name, value in vars(launch).items() if value is not None}
    if is_robot(domain):
        own.pop('step_period', None)  # the robot would pause between actions
    folder = given.get('out', own.pop('directory', default_folder(domain)))
    directory = Path(os.path.abspath(folder))
    with refusing(ValueError):
        setup = Setup(domain=domain, **{**own, **given, 'directory': directory})
        only = node_names(setup.only)
        known = is_registered(domain) or is_robot(domain)
        if known or not only or 'game' in only:  # otherwise, the game is elsewhere
            game = open_domain(domain, setup.domain_parameters)
            if setup.taught:
                simulated(game, 'the simulated teacher')
            check_method(setup.learn, game)
            for formula in setup.derive:
                derive(game, formula)
            if setup.joy:
                Gamepad(read_mapping(setup.joy), game.actions)
            if 'ranges' in game.parameters:  # the nodes need not measure them again
                setup = replace(setup, parameter=[*game.parameters.items()], features=None)
        processes(setup)
    topics = Selection(setup.namespace, setup.record_topics, setup.record_exclude)
    if setup.record and (missing := topics.missing_for_evaluation):
        if evaluated:
            raise CommandError(missing)
        print_line(missing)
    return setup


def known_code(code: str, known: Iterable[str]) -> str:
    """
    Return the code of a participant; ask in this terminal if a known code differs only in case.

    :raises CommandError: it is another participant, who needs another code.
    """
    similar = similar_code(code, known)
    question = _('{similar} has taken part. Continue as {similar}?').format(similar=similar)
    if similar and not confirmed(question):
        raise CommandError(str(SimilarCodeError(code, similar)))
    return similar or code


def new_name(prefix: str) -> str:
    """Return a name with date and time; names sort chronologically."""
    return time.strftime(f'{prefix}-%Y%m%d-%H%M%S')


def default_folder(domain: str) -> Path:
    """Return the folder for data of a domain, without characters unsuitable in paths."""
    return Path('runs') / re.sub(r'[^\w.-]+', '-', title(domain))


def title(domain: str) -> str:
    """Return a short name of a domain: for a robot, the name of its file."""
    return robot_file(domain)[0].stem if is_robot(domain) else domain


def check_place(namespace: str) -> None:
    """
    Check a namespace and the ROS settings of the shell.

    :raises CommandError: the namespace is invalid.
    :raises MiddlewareError: ROS cannot start with these settings.
    """
    if not _NAMESPACE.fullmatch(namespace):
        raise CommandError(f'{namespace!r} is not a namespace; write one like / or /room_1/left')
    check_settings(thorough=True)


@dataclass(frozen=True)
class Session:
    """The processes of a launch and the node that controls them."""

    setup: Setup
    launcher: Launcher
    graph: Conductor
    interrupts: Interrupts
    stop_problems: list[str] = field(default_factory=list)  # failures of nodes while stopping

    @property
    def bags(self) -> list[Path]:
        """The bags of the session: the first, and one for each restart of the recorder."""
        return parts(self.setup.bag) or [self.setup.bag]

    def check(self, *optional: str) -> None:
        """
        Check the processes, and check for an interrupt.

        :param optional: as in ``Launcher.check``.
        :raises LaunchError: a node ended and is not restarted.
        :raises KeyboardInterrupt: SIGINT, SIGTERM or SIGHUP was received.
        """
        self.interrupts.check()
        self.launcher.check(*optional)

    def check_recording(self) -> None:
        """
        Check at the end of a session that everything was recorded.

        :raises LaunchError: the recorder died or has stopped; the message gives the reason.
        """
        self.launcher.check()
        if unrecorded := self.graph.unrecorded():
            raise LaunchError(unrecorded)

    def restarts(self) -> list[str]:
        """Return a sentence for each node that was restarted, and for gaps in the recording."""
        counts = Counter((end.node, end.how) for end in self.launcher.ends if end.again)
        lines = [
            f'the node {node} ended {"once" if count == 1 else f"{count} times"} ({how}) and was '
            'restarted'
            for (node, how), count in sorted(counts.items())
        ]
        if len(self.bags) > 1:
            names = ', '.join(map(str, self.bags))
            lines.append(f'the recording is in several bags, with gaps between them: {names}')
        return lines

    def end(self) -> int:
        """Report the problems of a session that has ended; return its exit status."""
        restarts = self.restarts()
        for line in restarts:
            print_line(line)
        return 1 if restarts or self.stop_problems else 0


def taught_options(domain: Domain) -> tuple[str, ...]:
    """Return the options to teach: the domain's suggestions, or else all reference options."""
    known = tuple(reference_options(domain))
    if not known:
        raise CommandError(
            f'{domain.name} has no reference options, which the simulated teacher needs; '
            f'teach it yourself: humanopts teach {domain.name}'
        )
    suggested = domain.teaching.options if isinstance(domain, HasTeachingDefaults) else ()
    return suggested or known


def wait_until_taught(running: Session) -> None:
    """
    Wait until the simulated teacher has finished and the last option has been received.

    :raises LaunchError: the teacher is stuck, or a node died.
    """
    graph, setup = running.graph, running.setup
    seconds = _TEACHING_SECONDS + (setup.step_period or 0.0)
    graph.wait(graph.teacher_finished, seconds, 'the simulated teacher', graph.teaching_progress)
    last = setup.taught[-1]
    graph.wait(lambda: graph.knows_learned(last), ARRIVAL_SECONDS, f'what was learned of {last!r}')


def check_folder(setup: Setup, *, new: bool = False) -> None:
    """
    Check that the output folder can be used.

    :param new: whether the folder must be empty or missing.
    :raises CommandError: the folder cannot be used; the message gives the reason.
    """
    folder = setup.directory
    try:
        str(folder).encode()  # parameters and the bag contain the path
    except UnicodeEncodeError:
        raise CommandError(f'{folder} is not in UTF-8; choose another --out') from None
    with refusing(OSError, what=f'cannot write in {folder}: '):
        if new and folder.is_dir() and any(folder.iterdir()):
            raise CommandError(f'{folder} is not empty; choose another --out')
        if setup.record and setup.bag.exists():
            raise CommandError(f'{setup.bag} already exists; choose another folder')
        made = [path for path in (folder, *folder.parents) if not path.exists()]
        folder.mkdir(parents=True, exist_ok=True)
        try:
            with tempfile.TemporaryFile(dir=folder) as probe:
                probe.write(bytes(4096))
                probe.flush()
        finally:
            with suppress(OSError):  # another process may have added a file
                for path in made:  # a refused launch leaves no folders
                    path.rmdir()


def print_line(line: str) -> None:
    """Print a line of the command on standard error, unbuffered."""
    print(printable(f'humanopts: {line}'), file=sys.stderr, flush=True)


@contextmanager
def place(
    namespace: str, names: Sequence[str] = USUAL, folder: Path | None = None
) -> Iterator[None]:
    """
    Reserve nodes in a namespace and an output folder.

    :raises OccupiedError: one of these nodes is already running there.
    """
    with only_launch(namespace, names, folder):
        check_free(namespace, names)
        yield


@contextmanager
def session(
    setup: Setup,
    progress: Callable[[Conductor], object] = lambda _: None,
    report: Callable[[str], object] = print_line,
    restarts: int = MAX_RESTARTS,
    *,
    new: bool = False,
) -> Iterator[Session]:
    """
    Launch a graph, wait until it is ready, and finally stop it, the recorder last.

    A node that ends meanwhile is restarted, which is reported here, on the graph and in its log.
    Nothing is written before it is certain that no other launch runs these nodes.

    :param progress: callback during a wait, about twenty times a second.
    :param restarts: maximum number of consecutive restarts of a node.
    :param report: callback for a line when a node ends, is stopped or continues.
    :param new: whether the output folder must be empty or missing.
    :raises OccupiedError: one of the nodes is already running, or another launch uses the folder.
    :raises CommandError: the output folder cannot be used.
    :raises LaunchError: a node ended and is not restarted, or does not become ready.
    :raises KeyboardInterrupt: SIGINT, SIGTERM or SIGHUP was received; everything is stopped.
    """
    specs = processes(setup)
    launcher = Launcher(specs, setup.directory / 'log', setup.namespace, restarts=restarts)

    def watch() -> None:
        running.check()
        progress(graph)

    names = [spec.name for spec in specs if not spec.terminal]
    with (
        tolerant_output(),
        place(setup.namespace, names, setup.directory),
        catch_interrupts() as interrupts,
    ):
        check_folder(setup, new=new)
        interrupts.check()
        graph = Conductor(setup.namespace, common_parameters(setup), setup.bag, watch=watch)
        running = Session(setup, launcher, graph, interrupts)

        def on_end(end: NodeExit, instance: str) -> None:
            graph.note_end(end, instance)
            if end.again:  # otherwise, the session fails with this error
                report(end.text)

        launcher.on_start, launcher.on_end = graph.note_start, on_end
        launcher.report, launcher.wake = report, graph.wake
        graph.report = report
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
                running.stop_problems.extend(launcher.stop())
                for problem in running.stop_problems:
                    report(problem)


def run_until_interrupt(
    setup: Setup,
    started: Callable[[Session], object],
    report: Callable[[str], None],
    watch: Callable[[], object] = lambda: None,
) -> int:
    """
    Launch a graph and run it until an interrupt; return the exit status.

    :param started: callback when the graph is ready.
    :param report: callback for each line about a node.
    :param watch: periodic callback; may raise KeyboardInterrupt to end the launch.
    :raises LaunchError: as in ``session``, or the recording has gaps.
    """
    running = None
    try:
        with session(setup, lambda _: watch(), report) as launched:
            running = launched

            def check() -> None:
                watch()
                launched.check(RECORDER)

            started(launched)
            try:
                launched.graph.run_until_interrupt(check, report)
            except KeyboardInterrupt:
                launched.check_recording()
                raise
    except KeyboardInterrupt:
        pass
    return 0 if running is None else running.end()


def run_in_terminal(setup: Setup, done: Callable[[Session], object] = lambda running: None) -> int:
    """
    Launch a graph, give the terminal to the person, and stop everything; return the exit status.

    :param done: callback when the terminal is free again, before the recording is checked.
    :raises LaunchError: as in ``session``, or the recording has gaps.
    """
    print(_('starting ...'), flush=True)
    lines: list[str] = []  # to print when the terminal is free
    say: Callable[[str], object] = print_line
    try:
        with session(setup, report=lambda line: say(line)) as running:
            say = lines.append

            def watch() -> None:
                running.graph.take(0.1)
                running.interrupts.check()
                if shell_job_ended():
                    raise KeyboardInterrupt

            status = running.launcher.run_terminal(watch)
            done(running)
            running.graph.catch_up()
            running.check_recording()
    finally:
        for line in lines:
            print_line(line)
    return running.end() or status
