"""
check_floor.py LOCK: check that a lock file's packages are installed and ours can be imported.

Print the versions, or the differences from the lock file. Import every module of src/ that needs
no graph, to check that none needs a feature of newer packages.
"""

from importlib import import_module
from importlib.metadata import version
from pathlib import Path
import re
import sys

PIN = re.compile(r'^([a-z0-9-]+)==(\S+) \\$', re.MULTILINE)  # without environment marker


def main(lock: Path, source: Path) -> int:
    """Check, print the result and return the exit status."""
    pins: dict[str, str] = dict(PIN.findall(lock.read_text(encoding='utf-8')))
    wrong = [
        f'{name} {found} is used instead of {pin}: make test-floor installs what it tests with'
        for name, pin in pins.items()
        if (found := version(name)) != pin
    ]
    for path in sorted(source.glob('humanopts_*/humanopts_*/**/*.py')):
        parts = path.relative_to(source).with_suffix('').parts[1:]
        if 'ros' in parts or parts[0] == 'humanopts_ros':
            continue
        name = '.'.join(parts).removesuffix('.__init__')
        try:
            import_module(name)
        except ImportError as error:
            wrong.append(f'{name} cannot be imported: {error}')
    print('\n'.join(wrong) or f'with {", ".join(map(" ".join, pins.items()))}')
    return 1 if wrong else 0


if __name__ == '__main__':
    sys.exit(main(Path(sys.argv[1]), Path('src')))
