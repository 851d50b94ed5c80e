"""
kilted.py FOLDER: copy this repository, with ROS 2 Kilted in place of Jazzy.

The packages of requirements-kilted.lock replace those of the other lock files. Files that have not
changed stay as they are, so that make builds only what is new.
"""

from pathlib import Path
import re
import shutil
import subprocess
import sys

DISTRIBUTION = Path('tools/environment.sh')
LOCKS = 'requirements.lock', 'requirements-build.lock'


def blocks(lock: str) -> dict[str, str]:
    """Return the lines of each package in a lock file, by its name and markers."""
    found = re.split(r'(?m)^(?=[a-z])', lock)
    return {re.split(r'==|@', block)[0] + block.partition(';')[2][:40]: block for block in found}


def merged(lock: str, kilted: str) -> str:
    """Return a lock file with another's packages in place of ROS and of those with equal names."""
    others = blocks(kilted)
    names = {re.split(r'[ =;]', name)[0] for name in others}
    kept = [
        block
        for block in blocks(lock).values()
        if not block.startswith('ros-') and re.split(r'[ =;]', block)[0] not in names
    ]
    return ''.join([*kept, *others.values()])


def main(root: Path, folder: Path) -> None:
    """Copy the files that git tracks; adapt the lock files and the name of the distribution."""
    listed = subprocess.run(['git', 'ls-files', '-z'], cwd=root, capture_output=True, check=True)
    kilted = (root / 'requirements-kilted.lock').read_text('utf-8')
    for name in filter(None, listed.stdout.decode().split('\0')):
        source, target = root / name, folder / name
        if not source.is_file():
            continue
        content = source.read_bytes()
        if name in LOCKS:
            content = merged(content.decode(), kilted).encode()
        elif Path(name) == DISTRIBUTION:
            content = content.replace(b'ROS_DISTRO=jazzy', b'ROS_DISTRO=kilted')
        if not target.is_file() or target.read_bytes() != content:
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(content)
            shutil.copymode(source, target)


if __name__ == '__main__':
    main(Path.cwd(), Path(sys.argv[1]))
