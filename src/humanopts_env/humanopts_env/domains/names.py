"""The names of domains, found through Python entry points without importing the domains."""

from functools import lru_cache
from importlib.metadata import entry_points, EntryPoints
from pathlib import Path
import sys

DOMAINS = 'humanopts.domains'
GYMNASIUM = 'gymnasium:'  # prefix of the id of a Gymnasium environment
ROBOT = 'ros:'  # prefix of the file of a robot's world
PACKAGES = {'MiniGrid-': 'minigrid', 'BabyAI-': 'minigrid'}  # package by prefix of its ids


def domain_names() -> list[str]:
    """Return the registered names, sorted."""
    return sorted(registered(DOMAINS).names)


def is_registered(name: str) -> bool:
    """Return whether the name is registered or has the prefix of Gymnasium environments."""
    return name.startswith(GYMNASIUM) or name in registered(DOMAINS).names


def is_robot(name: str) -> bool:
    """Return whether a domain is the world of a robot: ros:FILE.yaml or ros:FILE.py:CLASS."""
    return name.startswith(ROBOT)


def robot_file(name: str) -> tuple[Path, str]:
    """Return the absolute path of a robot's file, and its class; empty for a world file."""
    path, colon, kind = name.removeprefix(ROBOT).rpartition(':')
    if not colon or not path.endswith('.py'):
        path, kind = name.removeprefix(ROBOT), ''
    return Path(path).absolute(), kind


def package_of(env_id: str) -> str:
    """Return the module to import before an environment can be made; empty if none."""
    module, colon, _ = env_id.partition(':')
    return (
        module if colon else next((p for key, p in PACKAGES.items() if env_id.startswith(key)), '')
    )


def modules_of(name: str) -> list[str]:
    """Return the modules of a robot or Gymnasium environment that are slow to import."""
    if is_robot(name):
        return ['humanopts_env.ros.world_node']
    if not name.startswith(GYMNASIUM):
        return []
    package = package_of(name.removeprefix(GYMNASIUM))
    return ['humanopts_env.domains.gymnasium_replayed', *filter(None, [package])]


def registered(group: str) -> EntryPoints:
    """Return the entry points of a group, cached for each search path."""
    return _registered(group, tuple(sys.path))


@lru_cache
def _registered(group: str, path: tuple[str, ...]) -> EntryPoints:
    return entry_points(group=group)
