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


def edit(workspace: Path, name: str, old: str, new: str) -> None:
    path = workspace / name
    text = path.read_text(encoding='utf-8')
    assert old in text
    path.write_text(text.replace(old, new), encoding='utf-8')


def test_a_whole_package_has_no_problem(workspace: Path) -> None:
    assert problems(workspace) == []


@pytest.mark.parametrize('kind', ['exec_depend', 'test_depend', 'buildtool_depend', 'doc_depend'])
def test_a_key_that_rosdep_does_not_know_is_named(workspace: Path, kind: str) -> None:
    line = f'<{kind}>python3-mcap-pip</{kind}></package>'
    edit(workspace, 'src/humanopts_toy/package.xml', '</package>', line)
    named = [text for text in problems(workspace) if 'rosdep does not know' in text]
    package = workspace / 'src/humanopts_toy'
    assert named == [
        f'{package}/package.xml lists python3-mcap-pip, a key that rosdep does not know'
    ]


def test_an_import_alone_makes_no_key_known(workspace: Path) -> None:
    """The list of keys by import names is ours; it says nothing about what rosdep has."""
    edit(workspace, 'src/humanopts_toy/humanopts_toy/__init__.py', 'numpy', 'scipy')
    edit(workspace, 'src/humanopts_toy/package.xml', 'python3-numpy', 'python3-scipy')
    edit(workspace, 'rosdep/rosdistro_keys.txt', 'python3-numpy\n', '')
    [found] = problems(workspace)
    assert found.endswith('lists python3-scipy, a key that rosdep does not know')


def test_packages_of_the_workspace_are_known(workspace: Path) -> None:
    other = workspace / 'src/humanopts_other'
    other.mkdir()
    for name in ('README.md', 'CHANGELOG.rst', 'package.xml', 'setup.py'):
        text = FILES[f'src/humanopts_toy/{name}'].replace('humanopts_toy', 'humanopts_other')
        (other / name).write_text(text, encoding='utf-8')
    line = '<test_depend>humanopts_other</test_depend></package>'
    edit(workspace, 'src/humanopts_toy/package.xml', '</package>', line)
    assert problems(workspace) == []


@pytest.mark.parametrize(
    ('name', 'old', 'new', 'said'),
    [
        ('rosdep/humanopts.yaml', 'debian', 'fedora', 'no rule for python3-zstandard on debian'),
        ('rosdep/rosdistro_keys.txt', '# copied', 'python3-zstandard', 'as rosdistro does'),
        ('rosdep/rosdistro_keys.txt', '# copied', 'rclpy', 'rclpy, which no package.xml lists'),
        ('src/humanopts_toy/package.xml', '1.26.4', '1.26', 'version_gte="1.26.4"'),
        ('src/humanopts_toy/setup.py', '1.26.4', '1.25', 'does not require numpy>=1.26.4'),
        ('requirements-floor.in', '1.26.4', '2.1', 'does not require numpy>=2.1'),
        ('src/humanopts_toy/package.xml', 'format="3"', 'format="2"', 'not format 3'),
        ('src/humanopts_toy/package.xml', '<license>', '<licence>', 'package.xml'),
        (
            'src/humanopts_toy/CHANGELOG.rst',
            '0.1.0 (',
            '0.0.9 (',
            'no section "Forthcoming" or "0.1.0',
        ),
    ],
)
def test_what_is_wrong_is_named(workspace: Path, name: str, old: str, new: str, said: str) -> None:
    edit(workspace, name, old, new)
    assert said in '\n'.join(problems(workspace))


@pytest.mark.parametrize('name', ['README.md', 'CHANGELOG.rst'])
def test_a_page_that_is_missing_is_named(workspace: Path, name: str) -> None:
    (workspace / 'src/humanopts_toy' / name).unlink()
    [found] = problems(workspace)
    assert found.endswith(f'has no {name}')


def test_imports_and_manifest_agree(workspace: Path) -> None:
    edit(
        workspace, 'src/humanopts_toy/humanopts_toy/__init__.py', 'import numpy\n', 'import yaml\n'
    )
    missing, surplus = problems(workspace)[:2]
    assert missing.endswith('does not list python3-yaml')
    assert surplus.endswith('lists python3-numpy, which no code imports')
