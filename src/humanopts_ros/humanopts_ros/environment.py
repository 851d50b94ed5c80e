"""Environment variables that humanopts processes share."""

from importlib.resources import files
import os

LAUNCHER_PID = 'HUMANOPTS_LAUNCHER_PID'  # of the process that started a node; it ends with it
PROFILES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')  # Jazzy reads [0]
RANGE, PEERS = 'ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_STATIC_PEERS'


def prepare_discovery() -> None:
    """
    Make Fast DDS announce this process often, unless the user has chosen profiles.

    Where the graph is to stay on this machine (LOCALHOST, and no peers elsewhere), sockets are
    bound to the loopback interface. The profile says all that the range would, so the middleware
    is told to change nothing of it: with LOCALHOST it binds to every interface.
    """
    if any(name in os.environ for name in PROFILES):
        return
    profile = 'quick_discovery.xml'
    if os.environ.get(RANGE) == 'LOCALHOST' and not os.environ.get(PEERS):
        profile, os.environ[RANGE] = 'loopback_discovery.xml', 'SYSTEM_DEFAULT'
    os.environ[PROFILES[0]] = str(files('humanopts_ros') / profile)
