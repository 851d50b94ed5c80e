"""What the launch file for ROS from apt starts: the same processes as the command line does."""

import ast
from collections.abc import Iterator
from importlib.metadata import entry_points
from pathlib import Path
import subprocess
import sys
from typing import Any

from humanopts_learner.options.judge import Thresholds
from humanopts_teach.launching import processes as table
from humanopts_teach.launching import restarts, ros_launch
from humanopts_teach.launching.processes import (
    processes,
    ProcessSpec,
    Recording,
    Setup,
    StudyTurn,
)
from humanopts_teach.launching.ros_launch import (
    ARGUMENTS,
    LaunchArgumentError,
    launched,
    setup_from_launch,
    stop_seconds,
)
import pytest

FILE = Path(__file__).parents[1] / 'launch/humanopts.launch.py'
DEFAULTS = {argument.name: argument.default for argument in ARGUMENTS}


def specs_of(**values: str) -> list[ProcessSpec]:
    """Return the processes of a launch."""
    return processes(setup_from_launch({**DEFAULTS, **values}))


def names(**values: str) -> list[str]:
    """Return their names."""
    return [spec.name for spec in specs_of(**values)]


def test_defaults_launch_every_node_but_the_teachers() -> None:
    nodes = ['recorder', 'game', 'learner', 'lesson', 'option_server', 'planner']
    assert names() == nodes
    assert names(record='False', teach='false') == ['game', 'option_server', 'planner']
    assert names(diagnostics='true') == [*nodes, 'diagnostics']
    assert names(views='true') == [*nodes, 'views']
    assert names(only='lesson; game') == ['game', 'lesson']
    assert names(taught='go up; go down') == [*nodes, 'simulated_teacher']


def test_what_is_not_given_is_as_in_other_launches() -> None:
    setup = setup_from_launch({**DEFAULTS, 'seed': '7', 'taught': 'go up'})
    assert setup == Setup(
        domain='taxi',
        directory=Path('runs/launch').absolute(),
        seed=7,
        taught=('go up',),
        bag_name=setup.bag_name,
    )


def test_every_argument_reaches_a_parameter() -> None:
    values = {
        'domain': 'rooms',
        'domain_parameters': '{"goal": "G2"}',
        'out': '/data/study',
        'seed': '12',
        'strategy': 'coverage',
        'learn': 'goal',
        'budget': '9',
        'record_topics': '/odom; camera/*',
        'record_exclude': 'rosout',
        'split_bytes': '500000',
        'split_seconds': '60',
        'step_period': '2',
        'diagnostics': 'true',
        'views': 'true',
        'taught': 'go up; go down',
    }
    assert {*values, 'teach', 'record', 'only'} == set(DEFAULTS)
    specs = {spec.name: spec.parameters for spec in specs_of(**values)}
    assert specs['game']['domain'] == 'rooms'
    assert specs['game']['domain_parameters'] == '{"goal": "G2"}'
    assert specs['game']['step_period'] == 2.0
    assert isinstance(specs['game']['step_period'], float)
    asked = [specs['lesson'][name] for name in ('strategy', 'learn', 'budget')]
    assert asked == ['coverage', 'goal', 9]
    seeded = ('game', 'learner', 'lesson', 'option_server', 'simulated_teacher')
    assert [specs[name]['seed'] for name in seeded] == [12] * len(seeded)
    assert specs['learner']['directory'] == '/data/study/options'
    assert str(specs['recorder']['path']).startswith('/data/study/bags/launch-')
    assert specs['simulated_teacher']['options'] == ['go up', 'go down']
    for parameters in specs.values():
        assert parameters['record_topics'] == ['/odom', 'camera/*']
        assert parameters['record_exclude'] == ['rosout']
    limits = (specs['recorder']['max_bytes'], specs['recorder']['max_seconds'])
    assert limits == (500_000, 60.0)
    assert [type(limit) for limit in limits] == [int, float]


@pytest.mark.parametrize(
    ('name', 'value'),
    [
        ('seed', 'x'),
        ('seed', 'true'),
        ('seed', '1.5'),
        ('budget', ''),
        ('teach', 'perhaps'),
        ('record', '1'),
        ('step_period', 'slow'),
        ('split_bytes', '5M'),
        ('split_seconds', 'true'),
        ('only', 'games'),
        ('only', 'simulated_teacher'),
        ('domain_parameters', '[7]'),
        ('domain_parameters', '{"a": ' * 100_000),
        ('seed', '9' * 5000),
        ('step_period', 'NaN'),
        ('domain_parameters', 'rows=7'),
    ],
)
def test_bad_value_is_refused_by_name(name: str, value: str) -> None:
    with pytest.raises(LaunchArgumentError, match=f'^{name}:='):
        specs_of(**{name: value})


def test_a_domain_parameter_of_another_type_is_refused() -> None:
    firm = {'domain': 'gymnasium:FrozenLake-v1', 'domain_parameters': '{"is_slippery": false}'}
    assert setup_from_launch({**DEFAULTS, **firm}).domain_parameters == {'is_slippery': False}
    text = firm | {'domain_parameters': '{"is_slippery": "False"}'}
    with pytest.raises(LaunchArgumentError, match='is "False", and has to be true or false'):
        setup_from_launch({**DEFAULTS, **text})


def test_the_recorder_ends_last_and_has_more_time_than_the_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv('ROS_DOMAIN_ID', '229')
    specs = launched(setup_from_launch({**DEFAULTS, 'only': 'recorder; game; lesson'}), 'room')
    recorder, *others = specs
    assert recorder.parameters['outlasts'] == [spec.name for spec in others] == ['game', 'lesson']
    assert all('outlasts' not in spec.parameters for spec in others)
    term, kill = map(sum, zip(*(stop_seconds(spec.name) for spec in others), strict=True))
    assert stop_seconds('recorder')[0] > table.OUTLASTING > term / 2 + kill / 2


def test_a_launch_file_keeps_the_places_of_its_nodes_as_long_as_it_runs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv('ROS_DOMAIN_ID', '230')
    code = (
        'import sys\n'
        'from humanopts_teach.launching.ros_launch import ARGUMENTS, launched, setup_from_launch\n'
        'texts = {a.name: a.default for a in ARGUMENTS}\n'
        "launched(setup_from_launch({**texts, 'only': sys.argv[1]}), '')\n"
        'print(flush=True)\n'
        'sys.stdin.read()\n'
    )
    words = [sys.executable, '-c', code]
    pipes: Any = {'stdin': subprocess.PIPE, 'stdout': subprocess.PIPE, 'stderr': subprocess.PIPE}
    with subprocess.Popen([*words, 'game'], **pipes) as first:
        assert first.stdout is not None
        assert first.stdout.readline()
        for only, refused in (('game;lesson', True), ('lesson', False)):
            ended = subprocess.run(
                [*words, only], stdin=subprocess.DEVNULL, capture_output=True, check=False
            )
            said = ended.stderr.decode()
            assert (f'process {first.pid} of ' in said) == refused == bool(ended.returncode)
        first.communicate()
    assert subprocess.run([*words, 'game'], stdin=subprocess.DEVNULL, check=False).returncode == 0


def test_executables_are_installed_under_the_names_of_the_nodes() -> None:
    specs: list[ProcessSpec] = specs_of(taught='go up')
    scripts = {point.name: point.value for point in entry_points(group='console_scripts')}
    for spec in [*specs, *processes(Setup('taxi', Path('/x'), keyboard=True))]:
        assert scripts[spec.name] == f'{spec.module}:main'
        assert spec.module.startswith(f'{spec.package}.')


def test_launch_file_declares_every_argument_and_uses_what_there_is() -> None:
    tree = ast.parse(FILE.read_text('utf-8'))
    ours = dict(_imports(tree))
    assert ours == {
        'ARGUMENTS': ros_launch,
        'setup_from_launch': ros_launch,
        'launched': ros_launch,
        'stop_seconds': ros_launch,
        'ProcessSpec': table,
        'CANNOT_START': restarts,
        'MOST': restarts,
    }
    assert all(hasattr(module, name) for name, module in ours.items())
    functions = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    assert 'generate_launch_description' in functions
    assert all(argument.description for argument in ARGUMENTS)


def _imports(tree: ast.Module) -> Iterator[tuple[str, Any]]:
    modules = {module.__name__: module for module in (ros_launch, table, restarts)}
    for node in tree.body:
        if isinstance(node, ast.ImportFrom) and (node.module or '').startswith('humanopts'):
            yield from ((alias.name, modules[str(node.module)]) for alias in node.names)


@pytest.mark.parametrize('study', [None, StudyTurn('s', 'a', '[]', Path('/s/000-anna.jsonl'))])
def test_a_setup_is_the_same_after_json(study: StudyTurn | None) -> None:
    setup = Setup(
        'taxi',
        Path('/tmp/a\nfolder'),
        domain_parameters={'rows': 7, 'lively': True, 'name': 'é'},
        thresholds=Thresholds(3.0, 0.1, 0.2),
        taught=('go up', 'go down'),
        recording=Recording(('lesson/*',), ('a', 'b'), 5, 0.5),
        only=('game', 'lesson'),
        study=study,
    )
    line = setup.to_json()
    assert '\n' not in line
    assert Setup.from_json(line) == setup
