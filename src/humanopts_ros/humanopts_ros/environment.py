"""
The environment variables of the ROS that this Python environment contains.

ROS wheels install into the environment of Python, and nothing has to be sourced. Where another ROS
is sourced, its libraries and packages would be loaded instead.
"""

from importlib.resources import files
import os
from pathlib import Path
import sys

from humanopts_ros.middleware import RANGE

DISTRIBUTION = 'jazzy'  # of the wheels that humanopts-interfaces requires
PREFIXES = 'AMENT_PREFIX_PATH'
_INDEX = 'share/ament_index'  # folder of a prefix that ROS packages are installed into


def use_own_ros() -> None:
    """
    Set the variables that name the ROS wheels in this Python environment, if there are any.

    If another ROS is sourced, this process starts again without its variables.
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
