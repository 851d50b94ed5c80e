"""What memory is left: that of the machine, or of the control groups that a process is in."""

from pathlib import Path
import subprocess
import sys

from humanopts_teach.launching.usage import memory_left, memory_of_children
import psutil
import pytest

MB = 1_000_000


@pytest.mark.parametrize(
    ('group', 'own', 'files'),
    [
        (
            'lab.slice',  # its limit is that of what is below it
            '0::/lab.slice/teach.service\n',
            {'memory.max': 600 * MB, 'memory.current': 500 * MB, 'stat': 'inactive_file'},
        ),
        (
            '',  # as in a container, which sees its own group only
            '0::/docker/0123\n',
            {'memory.max': 600 * MB, 'memory.current': 500 * MB, 'stat': 'inactive_file'},
        ),
        (
            'memory/job',
            '9:name=systemd:/\n4:cpu,memory:/job\n0::/\n',
            {
                'memory.limit_in_bytes': 600 * MB,
                'memory.usage_in_bytes': 500 * MB,
                'stat': 'total_inactive_file',
            },
        ),
    ],
)
def test_the_limit_of_a_container_or_service_counts(
    tmp_path: Path, group: str, own: str, files: dict[str, object]
) -> None:
    folder = tmp_path / 'cgroup' / group
    (folder / 'teach.service').mkdir(parents=True)
    (folder / 'teach.service' / 'memory.max').write_text('max\n')
    stat = f'inactive_anon 1\n{files.pop("stat")} {50 * MB}\nanon 7\n'
    (folder / 'memory.stat').write_text(stat)
    for name, value in files.items():
        (folder / name).write_text(f'{value}\n')
    (tmp_path / 'own').write_text(own)
    assert memory_left(tmp_path / 'cgroup', tmp_path / 'own') == (150 * MB, 600 * MB)


def test_without_limits_the_memory_is_that_of_the_machine(tmp_path: Path) -> None:
    left, total = memory_left(tmp_path, tmp_path / 'own')
    assert total == psutil.virtual_memory().total
    assert 0 < left <= total


def test_the_memory_of_a_child_is_measured_with_all_below_it() -> None:
    nested = 'import os, subprocess, sys; x = bytes(range(256)) * 200_000; '
    nested += 'len(sys.argv) > 1 and subprocess.run([sys.executable, "-c", sys.argv[1]]); '
    nested += 'print(flush=True); sys.stdin.read()'
    inner = 'x = bytes(range(256)) * 400_000; print(flush=True); input()'
    with subprocess.Popen(
        [sys.executable, '-c', nested, inner],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    ) as child:
        assert child.stdout is not None
        child.stdout.readline()  # of the inner one
        assert 153 * MB < max(memory_of_children()) < 260 * MB
        child.communicate(b'\n')
