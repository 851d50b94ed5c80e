"""
Environment variables of the ROS wheels in this Python environment.

ROS wheels are installed into the Python environment, so nothing has to be sourced. If another ROS
is sourced, its libraries and packages would be loaded instead.
"""

from importlib.resources import files
import os
from pathlib import Path
import sys

from humanopts_ros.middleware import RANGE

DISTRIBUTION = 'jazzy'  # ROS distribution of the required wheels
PREFIXES = 'AMENT_PREFIX_PATH'
_INDEX = 'share/ament_index'  # folder in each prefix with ROS packages


def use_own_ros() -> None:
    """
    Set the variables for the ROS wheels in this Python environment, if any.

    If another ROS is sourced, restart this process without its variables.
    """
    if not Path(sys.prefix, _INDEX).is_dir():
        return  # ROS from apt, or none
    prefixes = os.environ.get(PREFIXES, '')
    own = Path(sys.prefix).resolve()
    if own in [Path(each).resolve() for each in prefixes.split(os.pathsep) if each]:
        return
    if prefixes:
        foreign = files('humanopts_ros').joinpath('foreign_variables.txt').read_text('utf-8')
        kept = {n: value for n, value in os.environ.items() if n not in foreign.split()}
        os.execve(sys.executable, sys.orig_argv, kept | {PREFIXES: sys.prefix})
    os.environ.update({PREFIXES: sys.prefix, 'ROS_DISTRO': DISTRIBUTION})
    os.environ.setdefault(RANGE, 'LOCALHOST')  # graphs stay on this machine
