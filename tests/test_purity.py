"""Pure code knows no ROS, at run time too; what the packages offer is light to import."""

import ast
from collections.abc import Iterator
from functools import cache
from importlib import import_module
import json
from pathlib import Path
import subprocess
import sys

import pytest

SOURCE = Path(__file__).parents[1] / 'src'
PACKAGES = ('humanopts_env', 'humanopts_learner', 'humanopts_teach')
ORDER = ('humanopts_ros', *PACKAGES, 'experiments', 'benchmarks')  # each imports earlier ones only
MODULES = sorted(
    path for package in PACKAGES for path in (SOURCE / package / package).rglob('*.py')
)
OUTSIDE = sorted(path for name in ORDER[-2:] for path in (SOURCE.parent / name).rglob('*.py'))
PURE = [path for path in MODULES if 'ros' not in path.relative_to(SOURCE).parts]
PURE_OF_ROS = (
    'humanopts_ros.environment',
    'humanopts_ros.limits',
    'humanopts_ros.middleware',
    'humanopts_ros.recording',
    'humanopts_ros.senders',
    'humanopts_ros.text_files',
    'humanopts_ros.workarounds',
)
PURE += [SOURCE / 'humanopts_ros' / f'{name.replace(".", "/")}.py' for name in PURE_OF_ROS]
ROS = ('rclpy', 'humanopts_interfaces', 'rcl_interfaces', 'builtin_interfaces', 'action_msgs')


def name_of(path: Path) -> str:
    return str(path.relative_to(SOURCE))


@cache
def imports(path: Path) -> list[str]:
    """Return the full name of everything that a module imports, inside functions too."""
    return list(_imports(path))


def _imports(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text('utf-8'))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f'{path} imports by a relative name'
            yield from (f'{node.module}.{alias.name}' for alias in node.names)


def is_ros(name: str) -> bool:
    top = name.partition('.')[0]
    if top == 'humanopts_ros':
        return not name.startswith(PURE_OF_ROS)
    return top in ROS or top.endswith(('_msgs', '_srvs', '_interfaces'))


def test_pure_code_imports_neither_ros_nor_messages() -> None:
    found = {name_of(path): [n for n in imports(path) if is_ros(n)] for path in PURE}
    assert {path: names for path, names in found.items() if names} == {}
    assert len(found) > 50


def test_each_package_has_one_conversion_module() -> None:
    converting = [name_of(p) for p in MODULES if p.name == 'convert.py']
    assert converting == [f'{name}/{name}/ros/convert.py' for name in PACKAGES]


def test_dependencies_run_one_way() -> None:
    for path in (*MODULES, *OUTSIDE):
        inside = path.relative_to(SOURCE if path in MODULES else SOURCE.parent)
        package = inside.parts[0]
        others = {name.partition('.')[0] for name in imports(path)} & set(ORDER)
        lower = set(ORDER[: ORDER.index(package)]) - set(ORDER[-2:])
        assert others <= {package, *lower}, path


# What a machine without ROS has: nothing to import, and no libraries to load.
WITHOUT_ROS = """
import json
import sys

class NoRos:
    def find_spec(self, name, path=None, target=None):
        if name.partition('.')[0] in ('rclpy', 'humanopts_interfaces', 'std_msgs'):
            raise ModuleNotFoundError(f'No module named {name!r}: there is no ROS here')

sys.meta_path.insert(0, NoRos())
try:
    import rclpy
except ModuleNotFoundError:
    pass
else:
    sys.exit('rclpy was imported after all')
from humanopts_teach.cli import main
for command in json.loads(sys.argv[1]):
    if main(['bag', *command]):
        sys.exit(f'{command} failed')
"""


def test_a_bag_is_read_where_there_is_no_ros(tmp_path: Path, lesson_bag: Path) -> None:
    bag = str(lesson_bag)
    commands = {
        ('info', bag): 'demonstrations',
        ('eval', bag): 'go to passenger and pickup',
        ('check', bag): '',
        ('play', bag): 'episode 1 of',
        ('export', bag, '--to', 'csv', '--out', str(tmp_path)): 'steps.csv',
    }
    done = subprocess.run(
        [sys.executable, '-c', WITHOUT_ROS, json.dumps([*commands])],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, '')
    assert [words for words in commands.values() if words not in done.stdout] == []


HEAVY = ('sklearn', 'scipy', 'matplotlib', 'pandas', 'gymnasium', 'rclpy', 'humanopts_interfaces')


@pytest.mark.parametrize('name', PACKAGES)
def test_every_name_that_a_package_offers_is_there(name: str) -> None:
    package = import_module(name)
    assert all(getattr(package, offered).__name__ for offered in package.__all__)
    assert set(package.__all__) <= set(dir(package))
    assert 9 <= len(package.__all__) <= 24
    with pytest.raises(AttributeError, match='nothing'):
        package.nothing  # noqa: B018


def test_importing_the_packages_imports_nothing_heavy() -> None:
    code = f'import sys, {", ".join(PACKAGES)}; print(*sys.modules)'
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True)
    assert {name.partition('.')[0] for name in done.stdout.split()}.isdisjoint(HEAVY)


def test_an_option_is_learned_and_planned_with_by_the_public_names_alone() -> None:
    code = """
from humanopts_env import generator, make_domain, reference_options
from humanopts_learner import judge_plan, learn_option, make_demonstration, plan, policy_accuracy
import sys

taxi = make_domain('taxi')
fetch = reference_options(taxi)['go to passenger and pickup']
demonstrations = []
for number in range(1, 31):
    states, actions = [taxi.reset(generator(1, 'start', number))], []
    while fetch.can_start(states[-1]):
        action = fetch.optimal_actions(states[-1])[0]
        actions.append(taxi.actions[action].name)
        states.append(taxi.step(states[-1], action, generator(1, 'step')).state)
    demonstrations.append(
        make_demonstration(
            taxi, 'pickup', states, actions, features=fetch.features, number=number
        )
    )
pickup = learn_option(demonstrations, taxi, seed=1)
assert policy_accuracy(pickup, taxi, fetch) > 0.5
policy = plan(taxi, [pickup], gamma=0.99)
assert policy.names[0] == 'pickup' and len(policy.names) == 7
performance = judge_plan(policy, seed=1, episodes=20)
assert performance.total.mean == judge_plan(plan(taxi), seed=1, episodes=20).total.mean
assert not {'rclpy', 'humanopts_interfaces', 'matplotlib'} & set(sys.modules)
"""
    subprocess.run([sys.executable, '-c', code], check=True, timeout=100)
