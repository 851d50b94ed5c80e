"""Options, grid sizes and printed counts of the benchmarks."""

from typing import Any

import pytest

SIDES = (5, 25, 50, 100, 200, 500)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option for the largest grid."""
    parser.addoption('--largest', type=int, help='side of the largest grid in planning')


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Parametrize planning benchmarks by grid, up to the largest."""
    if 'side' in metafunc.fixturenames:
        largest = metafunc.config.getoption('--largest')
        sides = [*(side for side in SIDES if side < largest), largest]
        metafunc.parametrize('side', sides, scope='module')


@pytest.fixture
def quick(request: pytest.FixtureRequest) -> bool:
    """Whether to run everything once, at a small size, without measuring."""
    return bool(request.config.getoption('--benchmark-disable'))


def pytest_terminal_summary(terminalreporter: Any, config: Any) -> None:
    """Show the counts, such as sweeps and lost messages."""
    for bench in config._benchmarksession.benchmarks:
        if bench.extra_info:
            counted = ', '.join(f'{name} {value:,}' for name, value in bench.extra_info.items())
            terminalreporter.write_line(f'{bench.group}, {bench.name}: {counted}')
