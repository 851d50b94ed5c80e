"""
Run the tests of the live graph repeatedly, with every core busy and slow discovery.

A seed determines the order of the files and the delays, so that a round can be repeated:
``make test-stress ROUNDS=1 SEED=7 ARGS=tests/test_recorder.py``.
"""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.resources import files
import os
from pathlib import Path
import random
import re
import signal
import subprocess
import sys
import time

LOGS = Path('build/stress')
LIVE = 'live and not slow and not chromium and not hosts'
BUSY = """
import os
parent = os.getppid()
while os.getppid() == parent:
    for _ in range(1_000_000):
        pass
"""
# Fast DDS announces a participant at its creation and then periodically. Our profile for a single
# machine initially announces it ten times per second.
USUAL = files('humanopts_ros') / 'loopback_discovery.xml'
ANNOUNCEMENTS = re.compile(r'(?<=<discovery_config>).*(?=</discovery_config>)', re.DOTALL)
LATE = """
<initialAnnouncements>
  <count>1</count><period><sec>0</sec><nanosec>{first}</nanosec></period>
</initialAnnouncements>
<leaseAnnouncement><sec>{seconds}</sec><nanosec>{nanoseconds}</nanosec></leaseAnnouncement>
"""


@contextmanager
def busy_cores() -> Iterator[None]:
    """Keep every core busy."""
    command = [sys.executable, '-c', BUSY]
    processes = [subprocess.Popen(command) for _ in range(os.cpu_count() or 1)]
    try:
        yield
    finally:
        for process in processes:
            process.terminate()
        for process in processes:
            process.wait()


def write_profile(chance: random.Random, path: Path) -> str:
    """Write a profile that delays the discovery of nodes, and return its description."""
    first, period = chance.uniform(0.2, 0.9), chance.uniform(1.0, 3.0)
    late = LATE.format(
        first=int(first * 1e9), seconds=int(period), nanoseconds=int(period % 1.0 * 1e9)
    )
    text, changed = ANNOUNCEMENTS.subn(late, USUAL.read_text(encoding='utf-8'))
    assert changed == 1
    path.write_text(text, encoding='utf-8')
    return f'announced again after {first:.1f} s, then every {period:.1f} s'


def run_round(chosen: list[str], seed: int, seconds: float) -> bool:
    """
    Run the tests once, with the output of pytest in a log; return whether all passed in time.

    :param chosen: test files, to run in random order.
    :param seconds: timeout; pytest is then interrupted and ends its nodes and processes.
    """
    chance = random.Random(seed)
    profile, log = LOGS / f'discovery-{seed}.xml', LOGS / f'{seed}.log'
    late = write_profile(chance, profile)
    print(f'seed {seed}: {late}; see {log}', flush=True)
    command = [sys.executable, '-m', 'pytest', '-q', '-rfE', '-p', 'no:cacheprovider', '-m', LIVE]
    with log.open('w', encoding='utf-8') as output:
        process = subprocess.Popen(
            [*command, *chance.sample(chosen, len(chosen))],
            stdout=output,
            stderr=subprocess.STDOUT,
            env={**os.environ, 'STRESS_PROFILE': str(profile.absolute())},
        )
        try:
            status = process.wait(seconds)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGINT)
            status = process.wait()
    lines = log.read_text(encoding='utf-8').splitlines()
    failed = [line for line in lines if line.startswith(('FAILED ', 'ERROR '))]
    print('\n'.join([*(f'seed {seed}: {line}' for line in failed), *lines[-1:]]), flush=True)
    return status == 0


def main() -> int:
    """Run all rounds; return 1 if a test failed or timed out."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('files', nargs='*', help='test files; default: all')
    parser.add_argument('--rounds', type=int, default=10)
    parser.add_argument('--seed', type=int, default=1, help='of the first round')
    parser.add_argument('--limit', type=float, default=7200.0, help='seconds for all rounds')
    options = parser.parse_args()
    LOGS.mkdir(parents=True, exist_ok=True)
    chosen = options.files or sorted(map(str, Path('tests').glob('test_*.py')))
    end = time.monotonic() + options.limit
    passed = 0
    with busy_cores():
        for seed in range(options.seed, options.seed + options.rounds):
            if (left := end - time.monotonic()) > 0:
                passed += run_round(chosen, seed, left)
    print(f'{passed} of {options.rounds} rounds passed')
    return int(passed < options.rounds)


if __name__ == '__main__':
    sys.exit(main())
