"""
Runs the tests of the live graph again and again, while every core is busy and discovery is late.

The order of the files and the delays follow from a seed, which each failure names, so that a round
can be run again: ``make test-stress ROUNDS=1 SEED=7 ARGS=tests/test_recorder.py``.
"""

import argparse
from collections.abc import Iterator, Sequence
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
NOTHING_LEFT = 5  # exit status of pytest where no test was chosen
BUSY = """
import os
parent = os.getppid()
while os.getppid() == parent:
    for _ in range(1_000_000):
        pass
"""
# Fast DDS announces a participant when it is made and then once in a period; the usual profile of
# nodes on one machine has it do so ten times a second at first.
USUAL = files('humanopts_ros') / 'loopback_discovery.xml'
ANNOUNCEMENTS = re.compile(r'(?<=<discovery_config>).*(?=</discovery_config>)', re.DOTALL)
LATE = """
<initialAnnouncements>
  <count>1</count><period><sec>0</sec><nanosec>{first}</nanosec></period>
</initialAnnouncements>
<leaseAnnouncement><sec>{seconds}</sec><nanosec>{nanoseconds}</nanosec></leaseAnnouncement>
"""


def live_files(chosen: Sequence[str]) -> list[str]:
    """Return the files that have tests of the live graph, among those chosen; none chosen: all."""
    command = [sys.executable, '-m', 'pytest', '--collect-only', '-q', '-m', LIVE, *chosen]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    found = [line.partition('::')[0] for line in done.stdout.splitlines() if '::' in line]
    if done.returncode not in (0, NOTHING_LEFT) or not found:
        sys.exit(f'no tests of the live graph were found:\n{done.stdout}')
    return sorted(set(found))


@contextmanager
def busy_cores() -> Iterator[None]:
    """Keep every core busy meanwhile, by a process for each."""
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
    """Write a profile by which nodes are found late, and return it in words."""
    first, period = chance.uniform(0.2, 0.9), chance.uniform(1.0, 3.0)
    seconds = int(period)
    late = LATE.format(
        first=int(first * 1e9), seconds=seconds, nanoseconds=int((period - seconds) * 1e9)
    )
    text, changed = ANNOUNCEMENTS.subn(late, USUAL.read_text(encoding='utf-8'))
    assert changed == 1
    path.write_text(text, encoding='utf-8')
    return f'announced again after {first:.1f} s, then every {period:.1f} s'


def run_file(file: str, name: str, profile: Path, seconds: float) -> list[str] | None:
    """
    Run the tests of a file.

    :param name: of the log, which is kept where something failed.
    :param seconds: that are left; then pytest is interrupted.
    :return: the tests that failed; None: there was not time enough.
    """
    if seconds <= 0:
        return None
    log = LOGS / f'{name}.log'
    command = [sys.executable, '-m', 'pytest', '-q', '-rfE', '-p', 'no:cacheprovider']
    command += ['-m', LIVE, file]
    environment = {**os.environ, 'STRESS_PROFILE': str(profile.absolute())}
    with log.open('w', encoding='utf-8') as output:
        process = subprocess.Popen(
            command, stdout=output, stderr=subprocess.STDOUT, env=environment
        )
        try:
            status = process.wait(seconds)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGINT)  # which ends its nodes and processes, too
            process.wait()
            return None
    if status == 0:
        log.unlink()
        return []
    lines = log.read_text(encoding='utf-8').splitlines()
    failed = [line for line in lines if line.startswith(('FAILED ', 'ERROR '))]
    return [f'{line} (see {log})' for line in failed] or [f'{file} ended with {status}, see {log}']


def main() -> int:
    """Run every file once in each round and report; the exit status is 1 where a test failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('files', nargs='*', help='test files; none: all with live tests')
    parser.add_argument('--rounds', type=int, default=10)
    parser.add_argument('--seed', type=int, default=1, help='of the first round')
    parser.add_argument('--limit', type=float, default=7200.0, help='seconds for all rounds')
    options = parser.parse_args()
    LOGS.mkdir(parents=True, exist_ok=True)
    chosen = live_files(options.files)
    runs, end = 0, time.monotonic() + options.limit
    failures: list[str] = []  # each with its round and seed
    left_out: list[str] = []  # files and rounds that there was no time for
    with busy_cores():
        for number in range(1, options.rounds + 1):
            seed = options.seed + number - 1
            chance = random.Random(seed)
            order = chance.sample(chosen, len(chosen))
            profile = LOGS / f'discovery-{seed}.xml'
            late = write_profile(chance, profile)
            print(f'round {number} of {options.rounds}, seed {seed}: {late}')
            for file in order:
                left = end - time.monotonic()
                found = run_file(file, f'{seed}-{Path(file).stem}', profile, left)
                if found is None:
                    left_out.append(f'{file} in round {number}')
                    continue
                runs += 1
                for failure in found:
                    failures.append(f'round {number}, seed {seed}: {failure}')
                    print(failures[-1], flush=True)
    print(f'{runs} runs of {len(chosen)} files, {len(failures)} failures')
    if left_out:
        more = f' and {len(left_out) - 5} more' if len(left_out) > 5 else ''
        print(f'no time in {options.limit:.0f} s for {", ".join(left_out[:5])}{more}')
    for failure in failures:
        print(failure)
    return int(bool(failures))


if __name__ == '__main__':
    sys.exit(main())
