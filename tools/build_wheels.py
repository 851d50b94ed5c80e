"""
Build the wheels and sdists of humanopts into a folder, such as dist/.

humanopts-interfaces contains the interfaces that the set-up has compiled, in the layout of the ROS
wheels: a prefix inside the Python environment. humanopts contains no code; its extras list the
packages for each use. The versions are those of package.xml.

Usage: build_wheels.py FOLDER
"""

from importlib.metadata import requires, version
from io import BytesIO
import json
from pathlib import Path
import shutil
import subprocess
import sys
import tarfile
from xml.etree import ElementTree

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

ROOT = Path(__file__).parent.parent
PACKAGES = ('humanopts_ros', 'humanopts_env', 'humanopts_learner', 'humanopts_teach')
INTERFACES = 'humanopts_interfaces'
WORK = ROOT / 'build/wheels'
BACKEND = '[build-system]\nrequires = ["setuptools"]\nbuild-backend = "setuptools.build_meta"\n'
# ROS packages that the nodes and the interfaces import; their dependencies are pinned as well.
ROS = (
    'rclpy[fastrtps]',
    'std-msgs',
    'std-srvs',
    'diagnostic-msgs',
    'nav-msgs',
    'visualization-msgs',
)
EXTRAS = {  # of humanopts; other extras belong to the packages that need them
    'ros': ['humanopts-interfaces'],
    'browser': ['humanopts-teach[browser]'],
    'study': ['humanopts-teach[study]'],
    'worlds': ['humanopts-env[worlds]'],
}
_SETUP = """
from setuptools import Distribution, setup


class Compiled(Distribution):
    def has_ext_modules(self):
        return True


setup(distclass=Compiled, **{settings})
"""

# Also for an old pip, which does not choose the wheel even where it fits.
_REFUSAL = """
import platform
import sys

here = *sys.version_info[:2], sys.platform, platform.machine()
if here == ({major}, {minor}, 'linux', 'x86_64'):
    raise SystemExit(
        'This pip is too old for the wheel of humanopts-interfaces; update it: '
        'python -m pip install --upgrade pip'
    )
raise SystemExit(
    'humanopts-interfaces {number} is compiled for Python {major}.{minor} on Linux, x86-64. '
    'Use that Python, or build the wheels with yours in a clone: make wheels PYTHON=python3.X'
)
"""


def version_of(package: str) -> str:
    """Return the version of a package in src/."""
    found = ElementTree.parse(ROOT / f'src/{package}/package.xml').findtext('version')
    assert found is not None
    return found


def pinned(names: tuple[str, ...]) -> list[str]:
    """
    Return requirements of ROS packages and all their ROS dependencies, at installed versions.

    Newer versions on the index belong to later distributions of ROS.
    """
    found: list[str] = []
    queue = [Requirement(f'ros-{name}') for name in names]
    for each in queue:  # grows during iteration
        if not each.name.startswith('ros-'):
            continue
        extras = {'', *each.extras}
        each.specifier, each.marker = SpecifierSet(f'=={version(each.name)}'), None
        if str(each) not in found:
            found.append(str(each))
            others = map(Requirement, requires(each.name) or ())
            queue += [
                o
                for o in others
                if not o.marker or any(o.marker.evaluate({'extra': e}) for e in extras)
            ]
    return sorted(found)


def build(folder: Path, into: Path, *kinds: str) -> None:
    """Build distributions of a folder: ``--wheel``, ``--sdist`` or both."""
    command = [Path(sys.executable).with_name('uv'), 'build', '--quiet', '--no-build-isolation']
    subprocess.run(
        [*command, '--python', sys.executable, '--out-dir', into, *kinds, folder], check=True
    )


def interfaces(into: Path) -> None:
    """Build the wheel of the compiled interfaces."""
    prefix, work = ROOT / 'install' / INTERFACES, WORK / INTERFACES
    (site,) = prefix.glob(f'lib/python3.*/site-packages/{INTERFACES}')
    shutil.copytree(site, work / INTERFACES, ignore=shutil.ignore_patterns('__pycache__'))
    data: dict[str, list[str]] = {}
    for path in sorted([*prefix.glob('lib/*.so'), *prefix.glob('share/**/*')]):
        inside = path.relative_to(prefix)
        if path.is_file() and inside.parts[:2] not in (('share', 'colcon-core'),):
            copy = work / 'prefix' / inside
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path, copy)
            data.setdefault(str(inside.parent), []).append(str(copy.relative_to(work)))
    settings = {
        'name': INTERFACES,
        'version': version_of(INTERFACES),
        'description': 'Compiled ROS 2 interfaces of humanopts',
        'long_description': 'The messages, services and actions of humanopts, compiled.',
        'long_description_content_type': 'text/plain',
        'license': 'Apache-2.0',
        'packages': [INTERFACES, *(f'{INTERFACES}.{kind}' for kind in ('msg', 'srv', 'action'))],
        'package_data': {'': ['*.so']},
        'data_files': [*data.items()],
        'install_requires': ['numpy>=1.26.4', *pinned(ROS)],
        'python_requires': f'=={sys.version_info.major}.{sys.version_info.minor}.*',
    }
    (work / 'setup.py').write_text(_SETUP.replace('{settings}', repr(settings)), 'utf-8')
    build(work, into, '--wheel')


def refusal(into: Path) -> None:
    """
    Build the sdist that pip chooses without a fitting wheel; its error message says what to do.

    pip could not compile the interfaces, since that needs ROS.
    """
    number, (major, minor) = version_of(INTERFACES), sys.version_info[:2]
    folder = f'{INTERFACES}-{number}'
    parts = {
        'PKG-INFO': f'Metadata-Version: 2.1\nName: {INTERFACES}\nVersion: {number}\n'
        'Summary: Compiled ROS 2 interfaces of humanopts\n'
        'Description-Content-Type: text/plain\n\nSee humanopts.\n',
        'pyproject.toml': '[build-system]\nrequires = []\n'
        'build-backend = "refusal"\nbackend-path = ["."]\n',
        'refusal.py': _REFUSAL.format(number=number, major=major, minor=minor),
    }
    with tarfile.open(into / f'{folder}.tar.gz', 'w:gz') as archive:
        for name, content in parts.items():
            member = tarfile.TarInfo(f'{folder}/{name}')
            member.size = len(content.encode())
            archive.addfile(member, BytesIO(content.encode()))


def everything(into: Path) -> None:
    """Build the package without code; its extras list the packages for each use."""
    number, work = version_of('humanopts_teach'), WORK / 'humanopts'
    work.mkdir(parents=True)
    extras = {**EXTRAS, 'all': [each for needed in EXTRAS.values() for each in needed]}
    lines = [
        BACKEND,
        '[project]',
        'name = "humanopts"',
        f'version = "{number}"',
        'description = "Teach options to an agent by demonstration, and plan with them"',
        'readme = "README.md"',
        'requires-python = ">=3.11"',
        f'dependencies = ["humanopts-teach=={number}"]',
        '[project.optional-dependencies]',
        *(f'{name} = {json.dumps(needed)}' for name, needed in extras.items()),
        '[tool.setuptools]',
        'packages = []',
    ]
    (work / 'pyproject.toml').write_text('\n'.join(lines) + '\n', 'utf-8')
    shutil.copy(ROOT / 'README.md', work)
    build(work, into, '--wheel', '--sdist')


def main() -> None:
    into = Path(sys.argv[1]).absolute()
    shutil.rmtree(WORK, ignore_errors=True)
    shutil.rmtree(into, ignore_errors=True)
    for package in PACKAGES:
        work = WORK / package
        shutil.copytree(
            ROOT / 'src' / package,
            work,
            ignore=shutil.ignore_patterns('test', '__pycache__', '*.egg-info', 'build'),
        )
        build(work, into, '--wheel', '--sdist')
    interfaces(into)
    refusal(into)
    everything(into)
    for path in sorted(into.glob('humanopts*')):
        print(f'{path.relative_to(Path.cwd())}  {path.stat().st_size / 1e6:.1f} MB')


if __name__ == '__main__':
    main()
