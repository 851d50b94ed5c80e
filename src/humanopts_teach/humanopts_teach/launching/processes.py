"""The process table of a launch, shared by the command line and the ROS launch file."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
import json
from pathlib import Path

from humanopts_env.domains.base import Parameter
from humanopts_env.domains.names import is_robot, ROBOT, robot_file
from humanopts_learner.options.judge import Thresholds
from humanopts_teach.command_line import LaunchOptions
from humanopts_teach.launching import MODULES, RECORDER
from pydantic import TypeAdapter

Value = Parameter | list[str]
_PATIENCE = 5.0  # s, maximum wait of a run for the game, in addition to the duration of a step


class UnknownNodeError(ValueError):
    """A launch has no node of this name; the text lists the known names."""


@dataclass(frozen=True)
class ProcessSpec:
    """One node in one process."""

    name: str  # node name and executable
    module: str  # run with python -m
    parameters: Mapping[str, Value] = field(default_factory=dict)

    @property
    def package(self) -> str:
        """The package of the executable."""
        return self.module.partition('.')[0]

    @property
    def late(self) -> bool:
        """Whether it starts after the others are ready."""
        return self.name == 'simulated_teacher'

    @property
    def terminal(self) -> bool:
        """Whether it takes over the terminal."""
        return self.name == 'keyboard_teleop'


@dataclass(frozen=True)
class Setup(LaunchOptions):
    """A launch: the options of the user, and the values added by the command."""

    domain: str
    directory: Path  # of demonstrations, options and the bag
    participant: str = 'p1'
    ask_participant: bool = True  # at the keyboard, which proposes that code
    teach: bool = True  # run lesson and learner
    taught: tuple[str, ...] = ()  # options that a simulated teacher teaches; empty: no teacher
    teacher_error_rate: float = 0.0
    keyboard: bool = False
    pictures: bool = True  # people see the world; False: only its features
    record: bool = True
    game_steps: int = 0  # steps that the command samples plans from; 0: the default
    bag_name: str = 'bag'
    only: str = ''  # nodes to start here, besides the terminal's, separated by commas; empty: all
    study: str = ''  # name of the study; empty: no study
    condition: str = ''
    study_parts: str = ''  # of the participant in this launch, JSON
    study_record: str = ''  # file of the participant's events
    language: str = ''  # of displayed texts, as in ``speaking``

    @property
    def bag(self) -> Path:
        """Path of the first bag; a restarted recorder writes another one next to it."""
        return self.directory / self.bag_name

    @property
    def options(self) -> Path:
        """Folder of the learner's option files."""
        return self.directory / 'options'

    @property
    def thresholds(self) -> Thresholds:
        """
        The thresholds of the criteria.

        :raises ValueError: they are out of range.
        """
        given = {name: getattr(self, name) for name in asdict(Thresholds())}
        return Thresholds(**{name: value for name, value in given.items() if value is not None})

    def to_json(self) -> str:
        """Return the setup as one line of JSON."""
        return TypeAdapter(Setup).dump_json(self).decode()

    @classmethod
    def from_json(cls, text: str) -> 'Setup':
        """Return the setup from the text of ``to_json``."""
        return TypeAdapter(cls).validate_json(text)


def processes(setup: Setup) -> list[ProcessSpec]:
    """
    Return the processes of a launch, the recorder first.

    :raises UnknownNodeError: ``only`` names a node that the launch does not have.
    """
    robot = is_robot(setup.domain)
    wanted = {
        RECORDER: setup.record,
        'game': not robot,
        'world': robot,
        'learner': setup.teach,
        'lesson': setup.teach,
        'diagnostics': setup.diagnostics,
        'views': setup.views,
        'joy_teleop': bool(setup.joy),
        'simulated_teacher': bool(setup.taught),
        'keyboard_teleop': setup.keyboard,
    }
    own = _own_parameters(setup)
    specs = [
        ProcessSpec(name, module, {**common_parameters(setup), **own.get(name, {})})
        for name, module in MODULES.items()
        if wanted.get(name, True)
    ]
    only = node_names(setup.only)
    names = [spec.name for spec in specs if not spec.terminal]
    if unknown := [name for name in only if name not in names]:
        raise UnknownNodeError(f'unknown node {unknown[0]!r}; choose from {", ".join(names)}')
    return [spec for spec in specs if spec.terminal or not only or spec.name in only]


def node_names(text: str) -> list[str]:
    """Return the names in a comma-separated text."""
    return [name.strip() for name in text.split(',') if name.strip()]


def _own_parameters(setup: Setup) -> dict[str, dict[str, Value]]:
    """Return the parameters that are specific to each node."""
    study: dict[str, Value] = {
        'study_parts': setup.study_parts,
        'study_record': setup.study_record,
    }
    return {
        RECORDER: {
            'expect_recorder': False,
            'path': str(setup.bag),
            'resume': True,
            'metadata': json.dumps(recorded_facts(setup)),
            'max_bytes': setup.split_bytes or 0,
            'max_seconds': setup.split_seconds or 0.0,
            'attach': [str(setup.options), *_world_files(setup)],
        },
        'game': {
            'domain': setup.domain,
            'domain_parameters': json.dumps(setup.domain_parameters),
            'seed': setup.seed,
            'step_period': setup.step_period or 0.0,
        },
        'world': {
            'world': setup.domain.removeprefix(ROBOT),
            'step_period': setup.step_period or 0.0,
        },
        'learner': {
            'directory': str(setup.options),
            'seed': setup.seed,
            **{n: v for n, v in asdict(setup.thresholds).items() if v is not None},
        },
        'lesson': {
            'directory': str(setup.directory / 'demonstrations'),
            'seed': setup.seed,
            'strategy': setup.strategy,
            'learn': setup.learn,
            'budget': setup.budget,
            **({'derive': list(setup.derive)} if setup.derive else {}),
        },
        'option_server': {
            'options_directory': str(setup.options),
            'seed': setup.seed,
            'no_progress_seconds': _PATIENCE + (setup.step_period or 0.0),
            'unstick': setup.unstick,
        },
        'planner': {'directory': str(setup.directory), 'unstick': setup.unstick},
        'joy_teleop': {'mapping': setup.joy},
        'simulated_teacher': {
            'options': list(setup.taught),
            'participant': setup.participant,
            'error_rate': setup.teacher_error_rate,
            'seed': setup.seed,
        },
        'keyboard_teleop': {
            'participant': setup.participant,
            'ask_participant': setup.ask_participant,
            'pictures': setup.pictures,
            'language': setup.language,
            'seed': setup.seed,
            **(study if setup.study else {}),
        },
    }


def _world_files(setup: Setup) -> list[str]:
    return [str(robot_file(setup.domain)[0])] if is_robot(setup.domain) else []


def recorded_facts(setup: Setup) -> dict[str, str]:
    """Return the settings that an evaluation of the bag needs, as texts."""
    facts = {
        'domain': setup.domain,
        'domain_parameters': json.dumps(setup.domain_parameters),
        'seed': str(setup.seed),
        **{name: repr(value) for name, value in asdict(setup.thresholds).items()},
        'strategy': setup.strategy,
        'budget': str(setup.budget),
        'teacher_error_rate': repr(setup.teacher_error_rate if setup.taught else None),
    }
    for path in _world_files(setup):
        facts |= {'domain': ROBOT + Path(path).name, 'world_file': Path(path).name}
    if not setup.unstick:
        facts['unstick'] = 'False'
    if setup.game_steps:
        facts['game_steps'] = str(setup.game_steps)
    if setup.taught or setup.keyboard:
        facts['participant'] = setup.participant
    if not setup.pictures:
        facts['picture'] = 'no'
    if setup.study:
        facts |= {'study': setup.study, 'condition': setup.condition}
    return facts


def common_parameters(setup: Setup) -> dict[str, Value]:
    """Return the recording parameters of all nodes; the recorder overrides one."""
    patterns: dict[str, Value] = {
        'record_topics': setup.record_topics,
        'record_exclude': setup.record_exclude,
    }
    return {'expect_recorder': setup.record} | {k: v for k, v in patterns.items() if v}
