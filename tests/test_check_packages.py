"""The check of the packages, which `make lint` runs on ours, names what would stop ROS tools."""

from pathlib import Path

import pytest

from tools.check_packages import problems

MANIFEST = """<?xml version="1.0"?>
<package format="3">
  <name>humanopts_toy</name>
  <version>0.1.0</version>
  <description>A package of one module.</description>
  <maintainer email="toy@example.org">toy</maintainer>
  <license>Apache-2.0</license>
  <exec_depend version_gte="1.26.4">python3-numpy</exec_depend>
  <exec_depend>python3-zstandard</exec_depend>
  <test_depend>python3-pytest</test_depend>
</package>
"""
CHANGELOG = """^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^
Changelog for package humanopts_toy
^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^

0.1.0 (2026-01-31)
------------------
* First release.
"""
CODE = """import json

import numpy
import zstandard
"""
SETUP = """setup(name='humanopts_toy', install_requires=['numpy>=1.26.4'])
"""
RULES = 'python3-zstandard: {debian: [python3-zstandard], ubuntu: [python3-zstandard]}\n'
FILES = {
    'src/humanopts_toy/package.xml': MANIFEST,
    'src/humanopts_toy/README.md': '# humanopts_toy\n',
    'src/humanopts_toy/CHANGELOG.rst': CHANGELOG,
    'src/humanopts_toy/humanopts_toy/__init__.py': CODE,
    'src/humanopts_toy/setup.py': SETUP,
    'requirements-floor.in': '# oldest\nnumpy==1.26.4.post1\n',
    'rosdep/rosdistro_keys.txt': '# copied\npython3-numpy\n\npython3-pytest\n',
    'rosdep/humanopts.yaml': RULES,
}


@pytest.fixture
def workspace(tmp_path: Path) -> Path:
    """A workspace with one package, of which nothing is wrong."""
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding='utf-8')
    return tmp_path


def test_a_whole_package_has_no_problem(workspace: Path) -> None:
    assert problems(workspace) == []


def test_packages_of_the_workspace_are_known(workspace: Path) -> None:
    other = workspace / 'src/humanopts_other'
    other.mkdir()
    for name in ('README.md', 'CHANGELOG.rst', 'package.xml', 'setup.py'):
        text = FILES[f'src/humanopts_toy/{name}'].replace('humanopts_toy', 'humanopts_other')
        (other / name).write_text(text, encoding='utf-8')
    line = '<test_depend>humanopts_other</test_depend></package>'
    manifest = MANIFEST.replace('</package>', line)
    (workspace / 'src/humanopts_toy/package.xml').write_text(manifest, encoding='utf-8')
    assert problems(workspace) == []


MANIFEST_FILE = 'src/humanopts_toy/package.xml'
CODE_FILE = 'src/humanopts_toy/humanopts_toy/__init__.py'
KEYS, TEST = 'rosdep/rosdistro_keys.txt', '<test_depend>python3-pytest</test_depend>'
CHANGES = 'src/humanopts_toy/CHANGELOG.rst'


@pytest.mark.parametrize(
    ('name', 'old', 'new', 'said'),
    [
        (MANIFEST_FILE, TEST, f'{TEST}<doc_depend>x-pip</doc_depend>', 'x-pip, a key that rosdep'),
        # The list of keys by import names is ours; rosdep does not know it.
        (KEYS, 'python3-numpy\n', '', 'lists python3-numpy, a key that rosdep does not know'),
        (CODE_FILE, 'import numpy', 'import yaml', 'does not list python3-yaml'),
        (CODE_FILE, 'import numpy', '', 'lists python3-numpy, which no code imports'),
        ('rosdep/humanopts.yaml', 'debian', 'fedora', 'no rule for python3-zstandard on debian'),
        (KEYS, '# copied', 'python3-zstandard', 'as rosdistro does'),
        (KEYS, '# copied', 'rclpy', 'rclpy, which no package.xml lists'),
        (MANIFEST_FILE, '1.26.4', '1.26', 'version_gte="1.26.4"'),
        ('src/humanopts_toy/setup.py', '1.26.4', '1.25', 'does not require numpy>=1.26.4'),
        ('requirements-floor.in', '1.26.4', '2.1', 'does not require numpy>=2.1'),
        (MANIFEST_FILE, 'format="3"', 'format="2"', 'not format 3'),
        (MANIFEST_FILE, '<license>', '<licence>', 'package.xml'),
        (CHANGES, '0.1.0 (', '0.0.9 (', 'no section "Forthcoming" or "0.1.0'),
        (CHANGES, '', None, 'has no CHANGELOG.rst'),
        ('src/humanopts_toy/README.md', '', None, 'has no README.md'),
    ],
)
def test_what_is_wrong_is_named(
    workspace: Path, name: str, old: str, new: str | None, said: str
) -> None:
    path = workspace / name
    text = path.read_text(encoding='utf-8')
    assert old in text
    path.unlink()
    if new is not None:
        path.write_text(text.replace(old, new), encoding='utf-8')
    assert said in '\n'.join(problems(workspace))
