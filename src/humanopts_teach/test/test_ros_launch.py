"""What the launch file for ROS from apt starts: the same processes as the command line does."""

import ast
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
import subprocess
import sys
from typing import Any

from humanopts_teach.cli import up_setup
from humanopts_teach.command_line import LaunchOptions
from humanopts_teach.commands import CommandError
from humanopts_teach.commands.ros_launch import (
    ARGUMENTS,
    launched,
    setup_from_launch,
    stop_seconds,
)
from humanopts_teach.launching import OUTLASTING
from humanopts_teach.launching.processes import processes, ProcessSpec, Setup
import pytest

FILE = Path(__file__).parents[1] / 'launch/humanopts.launch.py'
DEFAULTS = {name: default for name, (default, _) in ARGUMENTS.items()}


def specs_of(**values: str) -> list[ProcessSpec]:
    """Return the processes of a launch."""
    return processes(setup_from_launch({**DEFAULTS, **values}))


def names(**values: str) -> list[str]:
    """Return their names."""
    return [spec.name for spec in specs_of(**values)]


def test_defaults_are_those_of_up() -> None:
    nodes = ['recorder', 'game', 'learner', 'lesson', 'option_server', 'planner']
    assert names() == nodes
    setup = setup_from_launch(DEFAULTS)
    same = up_setup('taxi', False, '', [], LaunchOptions())
    assert setup == Setup(**{**vars(same), 'bag_name': setup.bag_name})
    assert names(no_record='True', views='false') == nodes[1:]
    assert names(diagnostics='true', views='true') == [*nodes, 'diagnostics', 'views']
    assert names(only='lesson, game') == ['game', 'lesson']


def test_every_argument_reaches_a_parameter() -> None:
    values = {
        'domain': 'rooms',
        'parameter': 'goal=G2',
        'namespace': '/room',
        'out': '/data/study',
        'seed': '12',
        'strategy': 'coverage',
        'learn': 'goal',
        'derive': 'row * col',
        'budget': '9',
        'unstick': 'false',
        'success': '0.8',
        'return_share': '0.4',
        'initiation_error': '0.2',
        'termination_error': '0.3',
        'exam': '3',
        'record_topics': '/odom; camera/*',
        'record_exclude': 'rosout',
        'split_bytes': '500k',
        'split_seconds': '60',
        'step_period': '2',
        'diagnostics': 'true',
        'views': 'true',
        'joy': 'default',
        'taught': 'go up; go down',
    }
    assert {*values, 'no_record', 'only', 'features'} == set(DEFAULTS)
    (game,) = specs_of(only='game', domain='gymnasium:CartPole-v1', features='observation')
    assert game.parameters['domain_parameters'] == '{"features": "observation"}'
    specs = {spec.name: spec.parameters for spec in specs_of(**values)}
    assert specs['game']['domain'] == 'rooms'
    assert specs['game']['domain_parameters'] == '{"goal": "G2"}'
    assert specs['game']['step_period'] == 2.0
    asked = [specs['lesson'][name] for name in ('strategy', 'learn', 'budget', 'derive')]
    assert asked == ['coverage', 'goal', 9, ['row * col']]
    assert (specs['option_server']['unstick'], specs['planner']['unstick']) == (False, False)
    thresholds = ('success', 'return_share', 'initiation_error', 'termination_error', 'exam')
    assert [specs['learner'][name] for name in thresholds] == [0.8, 0.4, 0.2, 0.3, 3]
    seeded = ('game', 'learner', 'lesson', 'option_server', 'simulated_teacher')
    assert [specs[name]['seed'] for name in seeded] == [12] * len(seeded)
    assert specs['learner']['directory'] == '/data/study/options'
    assert str(specs['recorder']['path']).startswith('/data/study/bags/up-')
    assert specs['simulated_teacher']['options'] == ['go up', 'go down']
    assert specs['joy_teleop']['mapping'] == 'default'
    for parameters in specs.values():
        assert parameters['record_topics'] == ['/odom', 'camera/*']
        assert parameters['record_exclude'] == ['rosout']
    limits = (specs['recorder']['max_bytes'], specs['recorder']['max_seconds'])
    assert limits == (500_000, 60.0)
    assert [type(limit) for limit in limits] == [int, float]


@pytest.mark.parametrize(
    ('name', 'value', 'said'),
    [
        ('seed', 'x', 'x'),
        ('no_record', 'perhaps', 'no-record'),
        ('only', 'games', 'games'),
        ('parameter', 'rows=', 'rows'),
        ('parameter', '{"a": ' * 100_000, 'NAME=VALUE'),
        ('namespace', 'room', 'room'),
    ],
)
def test_a_bad_value_is_refused_as_on_the_command_line(name: str, value: str, said: str) -> None:
    with pytest.raises(CommandError, match=said):
        specs_of(**{name: value})


def test_the_recorder_ends_last_and_has_more_time_than_the_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv('ROS_DOMAIN_ID', '229')
    asked = {'only': 'recorder, game, lesson', 'namespace': '/room'}
    recorder, *others = launched(setup_from_launch({**DEFAULTS, **asked}))
    assert recorder.parameters['outlasts'] == [spec.name for spec in others] == ['game', 'lesson']
    assert all('outlasts' not in spec.parameters for spec in others)
    term, kill = map(sum, zip(*(stop_seconds(spec.name) for spec in others), strict=True))
    assert stop_seconds('recorder')[0] > OUTLASTING > term / 2 + kill / 2


def test_a_launch_file_keeps_the_places_of_its_nodes_as_long_as_it_runs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv('ROS_DOMAIN_ID', '230')
    code = (
        'import sys\n'
        'from humanopts_teach.launching.place import only_launch\n'
        'from humanopts_teach.commands.ros_launch import ARGUMENTS, launched, setup_from_launch\n'
        'texts = {name: default for name, (default, _) in ARGUMENTS.items()}\n'
        "launched(setup_from_launch({**texts, 'only': sys.argv[1]}))\n"
        'print(flush=True)\n'
        'sys.stdin.read()\n'
    )
    words = [sys.executable, '-c', code]
    pipes: Any = {'stdin': subprocess.PIPE, 'stdout': subprocess.PIPE, 'stderr': subprocess.PIPE}
    with subprocess.Popen([*words, 'game'], **pipes) as first:
        assert first.stdout is not None
        assert first.stdout.readline()
        for only, refused in (('game,lesson', True), ('lesson', False)):
            ended = subprocess.run(
                [*words, only], stdin=subprocess.DEVNULL, capture_output=True, check=False
            )
            said = ended.stderr.decode()
            assert (f'process {first.pid} of ' in said) == refused == bool(ended.returncode)
        first.communicate()


def test_executables_are_installed_under_the_names_of_the_nodes() -> None:
    scripts = {point.name: point.value for point in entry_points(group='console_scripts')}
    for spec in processes(Setup('taxi', Path('/x'), keyboard=True, taught=('go up',))):
        assert scripts[spec.name] == f'{spec.module}:main'
        assert spec.module.startswith(f'{spec.package}.')


def test_the_launch_file_uses_what_there_is_and_every_argument_is_described() -> None:
    tree = ast.parse(FILE.read_text('utf-8'))
    ours = [
        (node.module, alias.name)
        for node in tree.body
        if isinstance(node, ast.ImportFrom) and (node.module or '').startswith('humanopts')
        for alias in node.names
    ]
    assert ours
    assert all(hasattr(import_module(str(module)), name) for module, name in ours)
    functions = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    assert 'generate_launch_description' in functions
    assert all(description for _, description in ARGUMENTS.values())


def test_a_setup_is_the_same_after_json() -> None:
    setup = Setup(
        'taxi',
        Path('/tmp/a\nfolder'),
        parameter=[['rows', 7], ['lively', True], ['name', 'é']],
        return_share=0.3,
        taught=('go up', 'go down'),
        record_topics=['lesson/*'],
        only='game,lesson',
        study='s',
        study_record='/s/000-anna.jsonl',
    )
    line = setup.to_json()
    assert '\n' not in line
    assert Setup.from_json(line) == setup
