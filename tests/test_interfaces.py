"""The interface files explain themselves, and mypy knows their fields."""

import ast
from pathlib import Path
import subprocess
import sys

from humanopts_interfaces import msg
from mypy import api
import pytest

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / 'src' / 'humanopts_interfaces'
FILES = sorted(
    path for kind in ('msg', 'srv', 'action') for path in (FOLDER / kind).glob(f'*.{kind}')
)
NUMBERED = ['std_msgs/Header header', 'string publisher_id', 'uint64 sequence']


@pytest.mark.parametrize('path', FILES, ids=lambda path: path.name)
def test_a_file_explains_itself_and_what_is_published_on_its_own_is_numbered(path: Path) -> None:
    text = path.read_text(encoding='utf-8')
    assert text.startswith('# ')
    parts = [line.partition('#') for line in text.splitlines()]
    declared = [(code.strip(), comment.strip()) for code, _, comment in parts if code.strip(' -')]
    assert [code for code, comment in declared if not comment] == []
    if 'Published by' in text.partition('\n\n')[0]:
        assert [code for code, _ in declared[:3]] == NUMBERED


@pytest.fixture(scope='module')
def stubs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Types of our messages, and of those that they contain."""
    out = tmp_path_factory.mktemp('stubs')
    share = Path(sys.prefix) / 'share'
    command = [sys.executable, ROOT / 'tools' / 'make_stubs.py', out, share, ROOT / 'src']
    subprocess.run(command, check=True)
    return out


def test_stubs_have_the_fields_of_the_messages_in_their_order(stubs: Path) -> None:
    text = (stubs / 'humanopts_interfaces' / 'msg' / '__init__.pyi').read_text('utf-8')
    classes = [node for node in ast.parse(text).body if isinstance(node, ast.ClassDef)]
    assert len(classes) == len(list((FOLDER / 'msg').glob('*.msg')))
    for found in classes:
        kind = getattr(msg, found.name)
        (init,) = [f for f in found.body if getattr(f, 'name', '') == '__init__']
        assert isinstance(init, ast.FunctionDef)
        names = [argument.arg for argument in init.args.kwonlyargs]
        assert names == list(kind.get_fields_and_field_types()), found.name


WRONG = """
from humanopts_interfaces.msg import GameState
from humanopts_interfaces.srv import ResetGame
state = GameState(episode=1, features=[1, 2], state='here')
GameState(epsode=1)
print(state.stat)
state.step = 'one'
ResetGame.Response.STATUS_GOOD
"""


def test_a_misspelt_field_is_a_type_error(
    stubs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cache: pytest.Cache
) -> None:
    """What mypy knows of Python itself is kept for the next time."""
    (tmp_path / 'wrong.py').write_text(WRONG)
    (tmp_path / 'none.toml').write_text('')
    monkeypatch.setenv('MYPYPATH', str(stubs))
    options = [
        '--config-file',
        str(tmp_path / 'none.toml'),
        '--cache-dir',
        str(cache.mkdir('mypy')),
    ]
    said, _, status = api.run([*options, str(tmp_path / 'wrong.py')])
    assert status == 1, said
    lines = [int(line.split(':')[1]) for line in said.splitlines() if ': error: ' in line]
    assert lines == [5, 6, 7, 8], said
