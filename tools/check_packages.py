"""
Check the packages of src/ as ROS tools see them, and print all problems.

Every package.xml must be valid, list exactly the packages imported by its code, and list only keys
known to rosdep: those copied from rosdistro (rosdep/rosdistro_keys.txt), our own
(rosdep/humanopts.yaml), and the packages of src/. The minimum versions in package.xml and setup.py
must be those of make test-floor (requirements-floor.in). Every package needs a README.md, and a
CHANGELOG.rst with a section for its version, which is the same for all
(catkin_package_version --bump patch src).
"""

import ast
from pathlib import Path
import re
import sys

from catkin_pkg.package import InvalidPackage, Package, parse_package
import yaml

# Import name -> rosdep key, if they differ.
KEYS = {
    'fastapi': 'python3-nicegui-pip',
    'gymnasium': 'python3-gymnasium-pip',
    'jinja2': 'python3-jinja2',
    'lazy_loader': 'python3-lazy-loader',
    'markupsafe': 'python3-jinja2',
    'matplotlib': 'python3-matplotlib',
    'mcap': 'mcap-ros2-support',  # depends on mcap, which has no key
    'mcap_ros2': 'mcap-ros2-support',
    'nicegui': 'python3-nicegui-pip',  # needs fastapi and uvicorn
    'numpy': 'python3-numpy',
    'markdown_it': 'python3-markdown-it',
    'pandas': 'python3-pandas',
    'PIL': 'python3-pil',
    'polib': 'python3-polib',
    'prompt_toolkit': 'python3-prompt-toolkit',
    'psutil': 'python3-psutil',
    'pydantic': 'python3-pydantic-pip',
    'pyreadstat': 'python3-pyreadstat-pip',
    'rich': 'python3-rich',
    'scipy': 'python3-scipy',
    'setproctitle': 'python3-setproctitle',
    'sklearn': 'python3-sklearn',
    'statsmodels': 'python3-statsmodels',
    'typer': 'python3-typer-pip',
    'starlette': 'python3-nicegui-pip',
    'typing_extensions': 'python3-typing-extensions',
    'uvicorn': 'python3-nicegui-pip',
    'yaml': 'python3-yaml',
    'zstandard': 'python3-zstandard',
}
FLOOR_KEYS = {
    'markdown-it-py': 'markdown-it',
    'pillow': 'pil',
    'pyyaml': 'yaml',
    'scikit-learn': 'sklearn',
}
OPTIONAL = {'distributed', 'minari', 'numba', 'pyarrow', 'quantecon'}  # used if installed
UNIMPORTED = {'std_msgs', 'launch', 'launch_ros'}  # used by messages and launch files
SYSTEMS = ('debian', 'ubuntu')  # for which every key in our list needs a rule


def imported(package: Path) -> set[str]:
    """Return the top-level names imported from other packages."""
    names: set[str] = set()
    for path in package.glob(f'{package.name}/**/*.py'):
        for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
            if isinstance(node, ast.Import):
                names |= {alias.name.split('.')[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                names.add(node.module.split('.')[0])
    return names - set(sys.stdlib_module_names) - OPTIONAL - {package.name}


def import_problems(package: Path, manifest: Package) -> list[str]:
    """Return the differences between the manifest and the imports, in words."""
    declared = {depend.name for depend in (*manifest.exec_depends, *manifest.build_depends)}
    needed = {KEYS.get(name, name) for name in imported(package)}
    return [
        f'{package}/package.xml does not list {name}' for name in sorted(needed - declared)
    ] + [
        f'{package}/package.xml lists {name}, which no code imports'
        for name in sorted(declared - needed - UNIMPORTED)
        if imported(package)
    ]


def page_problems(package: Path, version: str) -> list[str]:
    """Return the missing pages and sections of the changelog (REP 132), in words."""
    found = [
        f'{package} has no {name}'
        for name in ('README.md', 'CHANGELOG.rst')
        if not (package / name).is_file()
    ]
    if (changelog := package / 'CHANGELOG.rst').is_file():
        titles = changelog.read_text(encoding='utf-8').splitlines()
        if not any(t == 'Forthcoming' or t.startswith(f'{version} (') for t in titles):
            found.append(f'{changelog} has no section "Forthcoming" or "{version} (DATE)"')
    return found


def key_problems(root: Path, manifests: dict[Path, Package]) -> list[str]:
    """Return the keys unknown to rosdep, and the errors in our key lists."""
    lines = (root / 'rosdep/rosdistro_keys.txt').read_text(encoding='utf-8').splitlines()
    copied = {line for line in lines if line and not line.startswith('#')}
    own = yaml.safe_load((root / 'rosdep/humanopts.yaml').read_text(encoding='utf-8')) or {}
    kinds = ('buildtool', 'build', 'build_export', 'buildtool_export', 'exec', 'test', 'doc')
    listed = {
        package: {depend.name for kind in kinds for depend in getattr(manifest, f'{kind}_depends')}
        for package, manifest in manifests.items()
    }
    used = set[str]().union(*listed.values())
    known = copied | set(own) | {manifest.name for manifest in manifests.values()}
    return [
        *(
            f'{package}/package.xml lists {name}, a key that rosdep does not know'
            for package, names in listed.items()
            for name in sorted(names - known)
        ),
        *(
            f'rosdep/humanopts.yaml has {name}, as rosdistro does'
            for name in sorted(copied & {*own})
        ),
        *(
            f'rosdep has {name}, which no package.xml lists'
            for name in sorted((copied | {*own}) - used)
        ),
        *(
            f'rosdep/humanopts.yaml has no rule for {name} on {system}'
            for name, rules in own.items()
            for system in SYSTEMS
            if not rules.get(system)
        ),
    ]


def floor_problems(package: Path, manifest: Package, floor: str) -> list[str]:
    """Return the minimum versions that are missing or untested, in words."""
    setup = (package / 'setup.py').read_text('utf-8') if (package / 'setup.py').exists() else ''
    declared = {depend.name: depend.version_gte for depend in manifest.exec_depends}
    found = []
    for name, pin in re.findall(r'^([a-z0-9-]+)==(\d+(?:\.\d+)*)', floor, re.MULTILINE):
        key = f'python3-{FLOOR_KEYS.get(name, name)}'
        if key in declared and declared[key] != pin:
            found.append(f'{package}/package.xml does not list {key} with version_gte="{pin}"')
        if key in declared and f"'{name}>={pin}'" not in setup:
            found.append(f'{package}/setup.py does not require {name}>={pin}')
    return found


def problems(root: Path) -> list[str]:
    """Return the problems of the packages in src/ of a folder, in words."""
    found: list[str] = []
    manifests: dict[Path, Package] = {}
    floor = (root / 'requirements-floor.in').read_text(encoding='utf-8')
    for package in sorted((root / 'src').glob('humanopts_*')):
        try:
            manifest = manifests[package] = parse_package(str(package))
        except InvalidPackage as error:
            found.append(str(error))
            continue
        if manifest.package_format != 3:
            found.append(f'{package}: package.xml is not format 3')
        found += import_problems(package, manifest) + page_problems(package, manifest.version)
        found += floor_problems(package, manifest, floor)
    versions = {manifest.version for manifest in manifests.values()}
    if len(versions) > 1:
        found.append(f'the packages have several versions: {", ".join(sorted(versions))}')
    return found + key_problems(root, manifests)


if __name__ == '__main__':
    found = problems(Path())
    print('\n'.join(found), file=sys.stderr)
    sys.exit(1 if found else 0)
