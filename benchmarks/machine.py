"""What a reader of measured times must know of the machine, and nothing that names it."""

import importlib.metadata
import os
from pathlib import Path
import platform

PACKAGES = ('numpy', 'scipy', 'scikit-learn', 'rclpy', 'quantecon')
_PROCESSOR = 'model name'  # as Linux calls it


def machine_facts() -> dict[str, str | int]:
    """Return system, processor, cores that may be used, and versions of what does the work."""
    facts: dict[str, str | int] = {
        'system': platform.system(),
        'architecture': platform.machine(),
        'processor': _processor(),
        'cores': len(os.sched_getaffinity(0)),
        'python': platform.python_version(),
    }
    for name in PACKAGES:
        try:
            facts[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return facts


def _processor() -> str:
    try:
        lines = Path('/proc/cpuinfo').read_text('utf-8').splitlines()
    except OSError:
        return 'unknown'
    named = (line.partition(':')[2].strip() for line in lines if line.startswith(_PROCESSOR))
    return next(named, 'unknown')
