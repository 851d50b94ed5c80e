"""The example of a table of one's own: it learns, plans, draws, and the page about it is right."""

import contextlib
import io
from pathlib import Path
import re
import runpy
import sys

from humanopts_learner import load_option
import pytest

ROOT = Path(__file__).parents[1]
SCRIPT = ROOT / 'examples/own_table/learn_from_table.py'
PAGE = ROOT / 'docs/how-to/learn-from-a-table.md'


@pytest.fixture(scope='module')
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp('own')
    printed = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(printed):
        patch.setattr(sys, 'argv', [str(SCRIPT), '--out', str(folder)])
        runpy.run_path(str(SCRIPT), run_name='__main__')
    (folder / 'printed').write_text(printed.getvalue().replace(str(folder), 'runs/own_table'))
    return folder


def test_both_options_are_learned_and_drawn(out: Path) -> None:
    assert (out / 'options.png').read_bytes().startswith(b'\x89PNG')
    options = [load_option(path)[0] for path in sorted(out.glob('options/*/*.json'))]
    assert [(option.n_demonstrations, option.n_not_here) for option in options] == [(16, 10)] * 2


def test_the_page_shows_what_the_example_prints_and_the_columns_of_its_table(out: Path) -> None:
    page = PAGE.read_text()
    shown = re.findall(r'```text\n(.*?)```', page, re.DOTALL)
    assert shown == [(out / 'printed').read_text()]
    table = (SCRIPT.parent / 'demonstrations.csv').read_text()
    assert table.startswith(re.findall(r'```csv\n(.*?)```', page, re.DOTALL)[0])


def test_the_script_on_the_page_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    (code,) = re.findall(r'```python\n(.*?)```', PAGE.read_text(), re.DOTALL)
    monkeypatch.chdir(ROOT)
    exec(code, {})
