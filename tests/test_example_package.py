"""The example of a domain in a package of its own: its tests, and planning in it by its name."""

import os
from pathlib import Path
import subprocess
import sys
import tomllib

from humanopts_env.domains.base import is_enumerable
from humanopts_env.domains.registry import make_domain, reference_options
from humanopts_learner.options.option import options_from_references
from humanopts_learner.planning.evaluate import play
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
    returns = play(human, starts)
    assert returns.successes.all()
    assert (returns.decisions == 6).all()  # fill and water, three times
    assert returns.fallbacks.sum() == 0
    gain = primitive.solution.values[starts] - human.solution.values[starts]
    assert (gain > -1e-6).all()
    assert human.solution.sweeps < primitive.solution.sweeps
