"""The provenance of a recording: software versions, and files to attach."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
import hashlib
from importlib.metadata import PackageNotFoundError, version
import os
from pathlib import Path
import platform

UNKNOWN = 'unknown'
LOCK = 'requirements.lock'
OWN_VERSION = 'humanopts_version'
_PACKAGES = {
    OWN_VERSION: 'humanopts_teach',
    'numpy': 'numpy',
    'scikit-learn': 'scikit-learn',
}


def software() -> dict[str, str]:
    """Return the versions of packages that affect learning, and the lock file's SHA-256."""
    facts = dict.fromkeys(_PACKAGES, UNKNOWN)
    for name, package in _PACKAGES.items():
        with suppress(PackageNotFoundError):
            facts[name] = version(package)
    lock = lock_hash(Path(__file__).resolve().parents)
    return {**facts, 'python': platform.python_version(), 'lock_sha256': lock}


def lock_hash(places: Sequence[Path]) -> str:
    """Return the SHA-256 of the lock file of the first folder that is a checkout."""
    for place in places:
        with suppress(OSError):
            if (place / 'src' / 'humanopts_teach').is_dir():
                return hashlib.sha256((place / LOCK).read_bytes()).hexdigest()
    return UNKNOWN


def attachments(paths: Sequence[Path]) -> Iterator[tuple[str, Path]]:
    """
    Yield the files to attach to a bag, with names such as ``options/p1/go-to-goal.json``.

    :param paths: files, and folders with .json files; missing paths are skipped.
    """
    for path in paths:
        for file in sorted(path.rglob('*.json')) if os.path.isdir(path) else [path]:
            if os.path.isfile(file):  # also False if access is denied
                name = file.relative_to(path.parent).as_posix()
                yield name.encode('utf-8', 'replace').decode('utf-8'), file
