"""Environment variables that humanopts processes share."""

from importlib.resources import files
import os

LAUNCHER_PID = 'HUMANOPTS_LAUNCHER_PID'  # of the process that started a node; it ends with it
PROFILES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')  # Jazzy reads [0]


def prepare_discovery() -> None:
    """Make Fast DDS announce this process often, unless the user has chosen profiles."""
    if not any(name in os.environ for name in PROFILES):
        os.environ[PROFILES[0]] = str(files('humanopts_ros') / 'quick_discovery.xml')
