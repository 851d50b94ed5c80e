"""What memory is left: that of the machine, or of the control groups that a process is in."""

from pathlib import Path
import subprocess
import sys

from humanopts_teach.launching.usage import memory_left, memory_of_children
import psutil
import pytest

MB = 1_000_000


@pytest.mark.parametrize(
    ('group', 'own'),
    [
        ('lab.slice', '0::/lab.slice/teach.service\n'),  # its limit is that of what is below it
        ('', '9:name=systemd:/\n0::/docker/0123\n'),  # in a container, which sees its own only
    ],
)
def test_the_limit_of_a_container_or_service_counts(tmp_path: Path, group: str, own: str) -> None:
    folder = tmp_path / 'cgroup' / group
    (folder / 'teach.service').mkdir(parents=True)
    (folder / 'teach.service' / 'memory.max').write_text('max\n')
    (folder / 'memory.stat').write_text(f'inactive_anon 1\ninactive_file {50 * MB}\nanon 7\n')
    for name, value in (('max', 600 * MB), ('current', 500 * MB)):
        (folder / f'memory.{name}').write_text(f'{value}\n')
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
