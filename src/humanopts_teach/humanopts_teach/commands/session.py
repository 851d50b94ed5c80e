"""A launch for the length of one command: what is asked for, checked, and the graph that runs."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, fields, replace
import json
import os
from pathlib import Path
import re
import signal
import sys
import tempfile
import time
from typing import Any

from humanopts_env.domains.base import DomainError, Parameter
from humanopts_env.domains.registry import make_domain
from humanopts_learner.options.criteria import Thresholds, usual_thresholds
from humanopts_ros.recording import Selection
from humanopts_teach.commands.ending import CommandError, ENDING, interruptible
from humanopts_teach.commands.options import LaunchOptions
from humanopts_teach.launching import LaunchError
from humanopts_teach.launching.launcher import Launcher, only_launch
from humanopts_teach.launching.processes import common_parameters, processes, Recording, Setup
from humanopts_teach.ros.graph_client import GraphClient

_NAMESPACE = re.compile(r'/|(/[A-Za-z_][A-Za-z0-9_]*)+')  # of nodes, as ROS 2 allows them
_LAST_DOMAIN_ID = 232


def setup_from(
    domain: str,
    launch: LaunchOptions,
    default_out: Path,
    *,
    evaluated: bool = False,
    step_period: float = 0.0,
    **own: Any,
) -> Setup:
    """
    Return the setup that the options of a launch ask for.

    :param default_out: the folder where the user names none.
    :param evaluated: the command needs a bag that can be evaluated.
    :param step_period: seconds between steps of the machine where the user gives none.
    :param own: fields that the command sets itself.
    :raises CommandError: a domain parameter is not NAME=VALUE, the namespace or ROS_DOMAIN_ID is
        none, or the bag would not hold what an evaluation needs.
    """
    _check_place(launch.namespace)
    return Setup(
        domain=domain,
        directory=Path(os.path.abspath(launch.out or default_out)),
        domain_parameters=domain_parameters(launch),
        seed=launch.seed,
        strategy=launch.strategy,
        budget=launch.budget,
        thresholds=_thresholds(domain, launch),
        step_period=step_period if launch.step_period is None else launch.step_period,
        recording=_recording(launch, evaluated) if own.get('record', True) else Recording(),
        **own,
    )


def _recording(launch: LaunchOptions, evaluated: bool) -> Recording:
    """Return what goes into the bag; warn, or refuse, where it could not be evaluated."""
    include, exclude = tuple(launch.record_include), tuple(launch.record_exclude)
    if lacking := Selection(launch.namespace, include, exclude).unevaluable:
        if evaluated:
            raise CommandError(lacking)
        print(f'humanopts: {lacking}', file=sys.stderr)
    return Recording(include, exclude, launch.split_bytes or 0, launch.split_seconds or 0.0)


def _thresholds(domain: str, launch: LaunchOptions) -> Thresholds:
    """Return the domain's usual thresholds, with those that the user gives in their place."""
    given = {
        threshold.name: value
        for threshold in fields(Thresholds)
        if (value := getattr(launch, threshold.name)) is not None
    }
    try:
        played = make_domain(domain, domain_parameters(launch))
        return replace(usual_thresholds(played), **given)
    except ValueError as error:
        raise CommandError(str(error)) from error


def domain_parameters(launch: LaunchOptions) -> dict[str, Parameter]:
    """
    Return the domain's parameters.

    :raises CommandError: one is not NAME=VALUE.
    """
    return dict(_parameter(text) for text in launch.parameter)


def new_name(prefix: str) -> str:
    """Return a name that sorts by time and was not used before this second."""
    return time.strftime(f'{prefix}-%Y%m%d-%H%M%S')


def default_folder(domain: str) -> Path:
    """Return where the data of a domain goes: its name, with no character that paths dislike."""
    return Path('runs') / re.sub(r'[^\w.-]+', '-', domain)


def _check_place(namespace: str) -> None:
    if not _NAMESPACE.fullmatch(namespace):
        raise CommandError(f'{namespace!r} is not a namespace; one reads / or /room_1/left')
    number = os.environ.get('ROS_DOMAIN_ID') or '0'
    if not (number.isascii() and number.isdigit() and int(number) <= _LAST_DOMAIN_ID):
        raise CommandError(f'ROS_DOMAIN_ID is {number!r}, and must be from 0 to {_LAST_DOMAIN_ID}')


def _parameter(text: str) -> tuple[str, Parameter]:
    name, equals, value = text.partition('=')
    if not (name and equals):
        raise CommandError(f'--parameter {text!r} is not NAME=VALUE')
    try:
        parsed = json.loads(value)
    except json.JSONDecodeError:
        return name, value
    return name, parsed if isinstance(parsed, int | float | bool) else value


@dataclass(frozen=True)
class Session:
    """The processes of a launch and the node that conducts them."""

    launcher: Launcher
    graph: GraphClient
    unclean: list[str] = field(default_factory=list)  # nodes that failed at their end, in words

    def check_recording(self) -> None:
        """
        Check at the end of a session that everything was recorded, as far as is known.

        :raises LaunchError: the recorder died, or has stopped; the text says why.
        """
        self.launcher.check()
        if unrecorded := self.graph.unrecorded():
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

    def watch() -> None:
        launcher.check()
        progress(graph)

    with only_launch(namespace), interruptible():
        graph = GraphClient(namespace, common_parameters(setup), setup.bag, watch=watch)
        running = Session(launcher, graph)
        try:
            for late in (False, True):
                launcher.start(late=late)
                graph.wait_ready(launcher.node_names)
            yield running
        finally:
            for number in ENDING:
                signal.signal(number, signal.SIG_IGN)
            try:
                graph.close()
            finally:
                running.unclean.extend(launcher.stop())
                for problem in running.unclean:
                    print(f'humanopts: {problem}', file=sys.stderr)
