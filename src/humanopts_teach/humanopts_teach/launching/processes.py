"""The one table of processes: the command line and the ROS launch file both start from it."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
import json
from pathlib import Path

from humanopts_env.domains.base import Parameter
from humanopts_learner.options.judge import Thresholds
from humanopts_teach.launching import MODULES
from humanopts_teach.lesson import BUDGET, METHOD, STRATEGY
from pydantic import TypeAdapter

Value = Parameter | list[str]
RECORDER = 'recorder'
OUTLASTING = 20.0  # s that a recorder waits for the end of those whom it outlasts
_PATIENCE = 5.0  # s that a run waits for game, beside the time that game takes for a step


class UnknownNodeError(ValueError):
    """A launch has no node of a name; the text says which, and what there is."""


@dataclass(frozen=True)
class ProcessSpec:
    """One node in one process."""

    name: str  # node name and executable
    module: str  # run with python -m
    parameters: Mapping[str, Value] = field(default_factory=dict)

    @property
    def package(self) -> str:
        """The package that the executable belongs to."""
        return self.module.partition('.')[0]

    @property
    def late(self) -> bool:
        """Whether it is started when the others are ready."""
        return self.name == 'simulated_teacher'

    @property
    def terminal(self) -> bool:
        """Whether it takes over the terminal."""
        return self.name == 'keyboard_teleop'


@dataclass(frozen=True)
class Recording:
    """What goes into the bag, and in how many files."""

    topics: tuple[str, ...] = ()  # patterns of topics beside those of the graph
    exclude: tuple[str, ...] = ()  # patterns of topics that are left out
    split_bytes: int = 0  # size at which the next file is begun; 0: never
    split_seconds: float = 0.0  # time after which it is; 0: never


@dataclass(frozen=True)
class StudyTurn:
    """What a participant of a study does in one launch."""

    study: str  # its name
    condition: str
    parts: str  # JSON
    record: Path  # file of the participant's events


@dataclass(frozen=True)
class Setup:
    """What a launch starts."""

    domain: str
    directory: Path  # demonstrations, options and the bag go below it
    domain_parameters: Mapping[str, Parameter] = field(default_factory=dict)
    seed: int = 0
    thresholds: Thresholds = field(default_factory=Thresholds)
    strategy: str = STRATEGY
    learn: str = METHOD  # of learning, where the person asks for no other
    budget: int = BUDGET
    participant: str = 'p1'
    ask_participant: bool = True  # at the keyboard, where that code is only proposed
    teach: bool = True  # lesson and learner run
    taught: tuple[str, ...] = ()  # options that a simulated teacher teaches; empty: no teacher
    teacher_error_rate: float = 0.0
    keyboard: bool = False
    record: bool = True
    recording: Recording = field(default_factory=Recording)
    game_steps: int = 0  # that the command's plans are sampled from; 0: as many as is usual
    bag_name: str = 'bag'
    step_period: float = 0.0  # s between a machine's steps
    diagnostics: bool = False  # a node publishes /diagnostics
    views: bool = False  # a node publishes the game for RViz and Foxglove
    only: tuple[str, ...] = ()  # nodes that run here, besides the terminal's; empty: all
    study: StudyTurn | None = None  # at the keyboard

    @property
    def bag(self) -> Path:
        """Where the recorder writes; where it was started again, beside that."""
        return self.directory / self.bag_name

    @property
    def options(self) -> Path:
        """Where the learner keeps option files."""
        return self.directory / 'options'

    def to_json(self) -> str:
        """Return the setup as one line of JSON."""
        return TypeAdapter(Setup).dump_json(self).decode()

    @classmethod
    def from_json(cls, text: str) -> 'Setup':
        """Return the setup of ``to_json``."""
        return TypeAdapter(cls).validate_json(text)


def processes(setup: Setup) -> list[ProcessSpec]:
    """
    Return the processes of a launch, the recorder first.

    :raises UnknownNodeError: a node that is to run here is none of the launch.
    """
    wanted = {
        RECORDER: setup.record,
        'learner': setup.teach,
        'lesson': setup.teach,
        'diagnostics': setup.diagnostics,
        'views': setup.views,
        'simulated_teacher': bool(setup.taught),
        'keyboard_teleop': setup.keyboard,
    }
    own = _own_parameters(setup)
    specs = [
        ProcessSpec(name, module, {**common_parameters(setup), **own.get(name, {})})
        for name, module in MODULES.items()
        if wanted.get(name, True)
    ]
    if not setup.only:
        return specs
    names = [spec.name for spec in specs if not spec.terminal]
    if unknown := [name for name in setup.only if name not in names]:
        raise UnknownNodeError(f'unknown node {unknown[0]!r}; choose from {", ".join(names)}')
    return [spec for spec in specs if spec.terminal or spec.name in setup.only]


def _own_parameters(setup: Setup) -> dict[str, dict[str, Value]]:
    """Return the parameters of each node, besides those that all have."""
    recording, turn = setup.recording, setup.study
    return {
        RECORDER: {
            'expect_recorder': False,
            'path': str(setup.bag),
            'go_on': True,
            'metadata': json.dumps(recorded_facts(setup)),
            'max_bytes': recording.split_bytes,
            'max_seconds': recording.split_seconds,
            'attach': [str(setup.options)],
        },
        'game': {
            'domain': setup.domain,
            'domain_parameters': json.dumps(dict(setup.domain_parameters)),
            'seed': setup.seed,
            'step_period': setup.step_period,
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
        },
        'option_server': {
            'options_directory': str(setup.options),
            'seed': setup.seed,
            'no_progress_seconds': _PATIENCE + setup.step_period,
        },
        'simulated_teacher': {
            'options': list(setup.taught),
            'participant': setup.participant,
            'error_rate': setup.teacher_error_rate,
            'seed': setup.seed,
        },
        'keyboard_teleop': {
            'participant': setup.participant,
            'ask_participant': setup.ask_participant,
            'seed': setup.seed,
            **({'study_parts': turn.parts, 'study_record': str(turn.record)} if turn else {}),
        },
    }


def recorded_facts(setup: Setup) -> dict[str, str]:
    """Return the settings, as texts for the bag, that an evaluation of it needs."""
    facts = {
        'domain': setup.domain,
        'domain_parameters': json.dumps(dict(setup.domain_parameters)),
        'seed': str(setup.seed),
        **{name: repr(value) for name, value in asdict(setup.thresholds).items()},
        'strategy': setup.strategy,
        'budget': str(setup.budget),
        'teacher_error_rate': repr(setup.teacher_error_rate if setup.taught else None),
    }
    if setup.game_steps:
        facts['game_steps'] = str(setup.game_steps)
    if setup.taught or setup.keyboard:
        facts['participant'] = setup.participant
    if setup.study is not None:
        facts |= {'study': setup.study.study, 'condition': setup.study.condition}
    return facts


def common_parameters(setup: Setup) -> dict[str, Value]:
    """Return what every node but the recorder has to know about the recording."""
    given = setup.recording
    patterns = {'record_topics': given.topics, 'record_exclude': given.exclude}
    some = {name: list(values) for name, values in patterns.items() if values}
    return {'expect_recorder': setup.record, **some}
