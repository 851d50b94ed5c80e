"""Checks every package.xml: valid, complete, and naming every package that its code imports."""

import ast
from pathlib import Path
import sys

from catkin_pkg.package import InvalidPackage, parse_package

# Import name -> rosdep key, where the two differ.
KEYS = {
    'gymnasium': 'python3-gymnasium-pip',
    'jinja2': 'python3-jinja2',
    'lazy_loader': 'python3-lazy-loader',
    'joblib': 'python3-joblib',
    'markupsafe': 'python3-jinja2',
    'matplotlib': 'python3-matplotlib',
    'mcap': 'python3-mcap-pip',
    'mcap_ros2': 'python3-mcap-ros2-support-pip',
    'numpy': 'python3-numpy',
    'pandas': 'python3-pandas',
    'prompt_toolkit': 'python3-prompt-toolkit',
    'psutil': 'python3-psutil',
    'rich': 'python3-rich',
    'scipy': 'python3-scipy',
    'setproctitle': 'python3-setproctitle',
    'sklearn': 'python3-sklearn',
    'typer': 'python3-typer',
    'yaml': 'python3-yaml',
    'zstandard': 'python3-zstandard',
}
OPTIONAL = {
    'distributed',
    'minari',
    'numba',
    'pyarrow',
    'quantecon',
}  # used where they are installed
UNIMPORTED = {'std_msgs', 'launch', 'launch_ros'}  # fields of messages; launch files


def imported(package: Path) -> set[str]:
    """Return the top-level names that the package's code imports from elsewhere."""
    names: set[str] = set()
    for path in package.glob(f'{package.name}/**/*.py'):
        for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
            if isinstance(node, ast.Import):
                names |= {alias.name.split('.')[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                names.add(node.module.split('.')[0])
    return names - set(sys.stdlib_module_names) - OPTIONAL - {package.name}


def problems(package: Path) -> list[str]:
    """Return what is wrong with the package's manifest, in words."""
    try:
        manifest = parse_package(str(package))
    except InvalidPackage as error:
        return [str(error)]
    if manifest.package_format != 3:
        return [f'{package}: package.xml is not format 3']
    declared = {depend.name for depend in (*manifest.exec_depends, *manifest.build_depends)}
    needed = {KEYS.get(name, name) for name in imported(package)}
    return [
        f'{package}/package.xml does not list {name}' for name in sorted(needed - declared)
    ] + [
        f'{package}/package.xml lists {name}, which no code imports'
        for name in sorted(declared - needed - UNIMPORTED)
        if imported(package)
    ]


if __name__ == '__main__':
    found = [text for path in sorted(Path('src').glob('humanopts_*')) for text in problems(path)]
    print('\n'.join(found), file=sys.stderr)
    sys.exit(1 if found else 0)
