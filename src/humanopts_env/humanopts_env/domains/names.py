"""The names of domains, found through Python entry points without importing the domains."""

from functools import lru_cache
from importlib.metadata import entry_points, EntryPoints
import sys

DOMAINS = 'humanopts.domains'
GYMNASIUM = 'gymnasium:'  # prefix of the id of a Gymnasium environment


def domain_names() -> list[str]:
    """Return the registered names, sorted."""
    return sorted(registered(DOMAINS).names)


def is_registered(name: str) -> bool:
    """Return whether the name is registered or has the prefix of Gymnasium environments."""
    return name.startswith(GYMNASIUM) or name in registered(DOMAINS).names


def registered(group: str) -> EntryPoints:
    """Return the entry points of a group; packages are searched once per search path."""
    return _registered(group, tuple(sys.path))


@lru_cache
def _registered(group: str, path: tuple[str, ...]) -> EntryPoints:
    return entry_points(group=group)
