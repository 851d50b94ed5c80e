"""The one table of processes: the command line and the ROS launch file both start from it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
import json
from pathlib import Path

from humanopts_env.domains.base import Parameter
from humanopts_learner.options.criteria import Thresholds

Value = Parameter | list[str]
_PATIENCE = 5.0  # s that a run waits for game, beside the time that game takes for a step


@dataclass(frozen=True)
class ProcessSpec:
    """One node in one process."""

    name: str  # node name and executable
    package: str
    module: str  # run with python -m
    parameters: Mapping[str, Value] = field(default_factory=dict)
    late: bool = False  # started when the others are ready
    terminal: bool = False  # it takes over the terminal


@dataclass(frozen=True)
class Recording:
    """What goes into the bag, and in how many files."""

    include: tuple[str, ...] = ()  # patterns of topics; none: all
    exclude: tuple[str, ...] = ()
    split_bytes: int = 0  # size at which the next file is begun; 0: never
    split_seconds: float = 0.0  # time after which it is; 0: never


@dataclass(frozen=True)
class Setup:
    """What a launch is to do; the defaults are those of ``./humanopts up``."""

    domain: str
    directory: Path  # demonstrations, options and the bag go below it
    domain_parameters: Mapping[str, Parameter] = field(default_factory=dict)
    seed: int = 0
    thresholds: Thresholds = field(default_factory=Thresholds)
    strategy: str = 'failures'
    budget: int = 150
    until_no_failures: bool = True
    participant: str = 'p1'
    teach: bool = True  # lesson and learner run
    taught: tuple[str, ...] = ()  # options that a simulated teacher teaches; empty: no teacher
    teacher_error_rate: float = 0.0
    keyboard: bool = False
    record: bool = True
    recording: Recording = field(default_factory=Recording)
    bag_name: str = 'bag'
    step_period: float = 0.0  # s between a machine's steps

    @property
    def bag(self) -> Path:
        """Where the recorder writes."""
        return self.directory / self.bag_name

    @property
    def options(self) -> Path:
        """Where the learner keeps option files."""
        return self.directory / 'options'


def processes(setup: Setup) -> list[ProcessSpec]:
    """Return the processes of a launch, the recorder first."""
    specs = []
    if setup.record:
        specs.append(_recorder(setup))
    specs.append(_game(setup))
    if setup.teach:
        specs += [_learner(setup), _lesson(setup)]
    specs += [_option_server(setup), _spec('planner', 'humanopts_learner', 'planner_node', setup)]
    if setup.taught:
        specs.append(_simulated_teacher(setup))
    if setup.keyboard:
        specs.append(_keyboard_teleop(setup))
    return specs


def recorded_facts(setup: Setup) -> dict[str, str]:
    """Return what offline evaluation needs to arrive at the live numbers, for the bag."""
    facts = {
        'domain': setup.domain,
        'domain_parameters': json.dumps(dict(setup.domain_parameters)),
        'seed': str(setup.seed),
        'return_delta': repr(setup.thresholds.return_delta),
        'initiation_error': repr(setup.thresholds.initiation_error),
        'termination_error': repr(setup.thresholds.termination_error),
        'strategy': setup.strategy,
        'budget': str(setup.budget),
        'teacher_error_rate': repr(setup.teacher_error_rate if setup.taught else None),
    }
    if setup.taught or setup.keyboard:
        facts['participant'] = setup.participant
    return facts


def common_parameters(setup: Setup) -> dict[str, Value]:
    """Return what every node but the recorder is told of the recording."""
    return {'expect_recorder': setup.record, **_patterns(setup.recording)}


def _patterns(recording: Recording) -> dict[str, Value]:
    """Return the parameters of the recorder and of those who wait for it; none: all topics."""
    patterns = {'record_include': recording.include, 'record_exclude': recording.exclude}
    return {name: list(values) for name, values in patterns.items() if values}


def _spec(
    name: str,
    package: str,
    module: str,
    setup: Setup,
    *,
    late: bool = False,
    terminal: bool = False,
    **own: Value,
) -> ProcessSpec:
    common = _patterns(setup.recording) if name == 'recorder' else common_parameters(setup)
    parameters = {**own, **common}
    return ProcessSpec(name, package, f'{package}.ros.{module}', parameters, late, terminal)


def _recorder(setup: Setup) -> ProcessSpec:
    return _spec(
        'recorder',
        'humanopts_teach',
        'recorder',
        setup,
        path=str(setup.bag),
        metadata=json.dumps(recorded_facts(setup)),
        max_bytes=setup.recording.split_bytes,
        max_seconds=setup.recording.split_seconds,
        attach=[str(setup.options)],
    )


def _game(setup: Setup) -> ProcessSpec:
    return _spec(
        'game',
        'humanopts_env',
        'game_node',
        setup,
        domain=setup.domain,
        domain_parameters=json.dumps(dict(setup.domain_parameters)),
        seed=setup.seed,
        step_period=setup.step_period,
    )


def _learner(setup: Setup) -> ProcessSpec:
    return _spec(
        'learner',
        'humanopts_learner',
        'learner_node',
        setup,
        directory=str(setup.options),
        seed=setup.seed,
        return_delta=setup.thresholds.return_delta,
        initiation_error=setup.thresholds.initiation_error,
        termination_error=setup.thresholds.termination_error,
    )


def _lesson(setup: Setup) -> ProcessSpec:
    return _spec(
        'lesson',
        'humanopts_teach',
        'lesson_node',
        setup,
        directory=str(setup.directory / 'demonstrations'),
        seed=setup.seed,
        strategy=setup.strategy,
        budget=setup.budget,
        until_no_failures=setup.until_no_failures,
    )


def _option_server(setup: Setup) -> ProcessSpec:
    return _spec(
        'option_server',
        'humanopts_learner',
        'option_server',
        setup,
        options_directory=str(setup.options),
        seed=setup.seed,
        no_progress_seconds=_PATIENCE + setup.step_period,
    )


def _simulated_teacher(setup: Setup) -> ProcessSpec:
    return _spec(
        'simulated_teacher',
        'humanopts_teach',
        'simulated_teacher',
        setup,
        late=True,
        options=list(setup.taught),
        participant=setup.participant,
        error_rate=setup.teacher_error_rate,
        seed=setup.seed,
    )


def _keyboard_teleop(setup: Setup) -> ProcessSpec:
    return _spec(
        'keyboard_teleop',
        'humanopts_teach',
        'keyboard_teleop',
        setup,
        terminal=True,
        participant=setup.participant,
        seed=setup.seed,
    )
