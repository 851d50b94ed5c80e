"""The examples: a domain in a package of its own, and options from a table of one's own."""

import contextlib
import io
import os
from pathlib import Path
import re
import runpy
import subprocess
import sys
import tomllib

from humanopts_env.domains.base import is_enumerable
from humanopts_env.domains.registry import make_domain, reference_options
from humanopts_learner import load_option
from humanopts_learner.options.learned_option import options_from_references
from humanopts_learner.planning.exact_plan import play_plan
from humanopts_learner.planning.plan import make_plan
from humanopts_learner.planning.request import PlanRequest
import pytest

PACKAGE = Path(__file__).parents[1] / 'examples' / 'humanopts_greenhouse'


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the package known as its installation does, by what its pyproject.toml says."""
    project = tomllib.loads((PACKAGE / 'pyproject.toml').read_text())['project']
    lines = []
    for group, points in project['entry-points'].items():
        lines += [f'[{group}]', *(f'{name} = {value}' for name, value in points.items())]
    info = tmp_path / 'humanopts_greenhouse-0.1.0.dist-info'
    info.mkdir()
    about = f'Metadata-Version: 2.1\nName: {project["name"]}\nVersion: {project["version"]}\n'
    (info / 'METADATA').write_text(about)
    (info / 'entry_points.txt').write_text('\n'.join(lines))
    monkeypatch.syspath_prepend(str(PACKAGE))
    monkeypatch.syspath_prepend(str(tmp_path))


def test_its_own_tests_pass() -> None:
    """The contract of every domain, and its rules."""
    run = subprocess.run(
        [sys.executable, '-m', 'pytest', '-q', '-p', 'no:cacheprovider'],
        cwd=PACKAGE,
        env={**os.environ, 'PYTEST_DISABLE_PLUGIN_AUTOLOAD': '1'},
        capture_output=True,
        text=True,
        timeout=100,
    )
    assert run.returncode == 0, run.stdout


@pytest.mark.usefixtures('installed')
@pytest.mark.parametrize('size', [3, 4])
def test_it_is_planned_in_by_its_name(size: int) -> None:
    """Its two options are enough to water everything, and never better than all actions."""
    domain = make_domain('greenhouse', {'size': size})
    assert is_enumerable(domain)
    options = options_from_references(domain, reference_options(domain).values())
    starts = domain.start_states()
    human, primitive = (
        make_plan(domain, options, PlanRequest(name)) for name in ('human', 'primitive')
    )
    returns = play_plan(human, starts)
    assert returns.successes.all()
    assert (returns.decisions == 6).all()  # fill and water, three times
    assert returns.fallbacks.sum() == 0
    gain = primitive.solution.values[starts] - human.solution.values[starts]
    assert (gain > -1e-6).all()
    assert human.solution.sweeps < primitive.solution.sweeps


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
