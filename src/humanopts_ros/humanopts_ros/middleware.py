"""
Checks of the ROS settings in the environment; usable without ROS.

Invalid settings are reported in one line before anything is started. Otherwise the middleware
would abort the process, ignore the setting, or silently find no other node.
"""

import ipaddress
import os
from pathlib import Path
import re
import socket
import subprocess
import sys
from xml.etree import ElementTree

LAUNCHER_PID = 'HUMANOPTS_LAUNCHER_PID'  # pid of the launcher; nodes exit with it
INSTANCE = 'HUMANOPTS_INSTANCE'  # suffix of the publisher_id of a launched node
RESTARTS = 'HUMANOPTS_RESTARTS'  # number of previous restarts by the launcher
RANGE, PEERS = 'ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_STATIC_PEERS'
# Jazzy reads the first, later distributions the second.
PROFILES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
LAST_DOMAIN_ID = 232
LOOPBACK = '127.0.0.1'
_RANGES = 'LOCALHOST', 'SUBNET', 'SYSTEM_DEFAULT'
_RMW, _LOCALHOST_ONLY, _DOMAIN_ID = 'RMW_IMPLEMENTATION', 'ROS_LOCALHOST_ONLY', 'ROS_DOMAIN_ID'
_INSTALLED = 'share/ament_index/resource_index/rmw_typesupport'
_ANY_PORT = 7400  # no data is sent
_LOADS_PROFILES = """
import rclpy
rclpy.init(domain_id=0)
rclpy.create_node('reads_profiles')
"""
_FAULT = re.compile(r'XMLPARSER.* Error\S* (.+?) -> Function')
_COLOUR = re.compile(r'\x1b\[[\d;]*m')
_absent = ''  # value of RMW_IMPLEMENTATION that is not installed


class MiddlewareError(RuntimeError):
    """ROS cannot start with the environment's settings; the message names the setting and fix."""


def set_aside_absent() -> None:
    """
    Unset a configured middleware that is not installed; ``check_settings`` reports it.

    Otherwise, importing rclpy would end the process.
    """
    global _absent
    chosen, installed = os.environ.get(_RMW, ''), _installed()
    if chosen and installed and chosen not in installed:
        _absent = os.environ.pop(_RMW)


def _installed() -> list[str]:
    """Return the installed middlewares; empty if unknown."""
    # ROS wheels live in the Python environment and load only their own middlewares.
    for prefix in (sys.prefix, *os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)):
        found = Path(prefix, _INSTALLED)
        if prefix and found.is_dir():
            return sorted({path.name for path in found.iterdir()} - {'rmw_implementation'})
    return []


def check_settings(*, thorough: bool = False) -> None:
    """
    Check the environment variables that configure the middleware.

    :param thorough: whether to let Fast DDS validate the user's profile file; takes half a second.
    :raises MiddlewareError: ROS cannot start, or nodes would not find each other.
    """
    if _absent and not os.environ.get(_RMW):
        raise MiddlewareError(
            f'{_RMW} is {_absent!r}, which is not installed; unset it, or choose '
            f'{" or ".join(_installed())}'
        )
    number = os.environ.get(_DOMAIN_ID) or '0'
    if not (number.isascii() and number.isdigit() and int(number) <= LAST_DOMAIN_ID):
        raise MiddlewareError(
            f'{_DOMAIN_ID} is {number!r}, but must be from 0 to {LAST_DOMAIN_ID}'
        )
    if os.environ.pop(_LOCALHOST_ONLY, '') == '1':  # used before ROS Iron; takes precedence
        os.environ[RANGE] = 'LOCALHOST'
        os.environ.pop(PEERS, None)
    chosen = os.environ.get(RANGE)
    if chosen == 'OFF':
        raise MiddlewareError(
            f'{RANGE} is OFF, so nodes cannot find each other; unset it, or choose LOCALHOST for '
            'this machine or SUBNET for the network'
        )
    if chosen and chosen not in _RANGES:
        raise MiddlewareError(f'{RANGE} is {chosen!r}; choose from {", ".join(_RANGES)}')
    if os.environ.get(PEERS):
        peers = [peer.strip() for peer in os.environ[PEERS].split(';')]
        os.environ[PEERS] = ';'.join(filter(None, peers))
    for peer in static_peers():
        if fault := _fault_of_address(peer):
            raise MiddlewareError(
                f'{PEERS} names {peer!r}, {fault}; give addresses like 192.168.1.20, separated by '
                ';'
            )
    for name in PROFILES:
        if not os.environ.get(name):
            os.environ.pop(name, None)  # Fast DDS would look for a file with an empty name
            continue
        if Path(os.environ[name]).parent == Path(__file__).parent:
            continue
        fault = _fault_of_profile(Path(os.environ[name]))
        if fault or (thorough and (fault := _fault_that_fast_dds_finds())):
            raise MiddlewareError(
                f'{name} is {os.environ[name]!r}, {fault}; unset it, or name a file of profiles'
            )
    if is_local() and not address_towards(LOOPBACK):
        raise MiddlewareError(
            'the loopback interface of this machine is down, and nodes cannot find each other; '
            'switch it on: sudo ip link set lo up'
        )


def static_peers() -> list[str]:
    """Return the peers configured in the environment."""
    return [peer for each in os.environ.get(PEERS, '').split(';') if (peer := each.strip())]


def is_local() -> bool:
    """Return whether the graph is restricted to this machine."""
    return os.environ.get(RANGE) == 'LOCALHOST' and not static_peers()


def address_towards(peer: str) -> str:
    """Return this machine's address on the route to a peer; empty if there is no route."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((peer, _ANY_PORT))
        except (OSError, UnicodeError):  # no route, or no such name
            return ''
        return str(probe.getsockname()[0])


def _fault_of_address(peer: str) -> str:
    """Return the error in a machine's address or name; empty if none, or only temporary."""
    try:
        if ipaddress.ip_address(peer).version != 4:
            return 'which is not an IPv4 address'
    except ValueError:
        try:
            socket.getaddrinfo(peer, None, socket.AF_INET)
        except (OSError, UnicodeError) as error:
            # Without a network, no name can be resolved; the network may come up soon.
            if not (isinstance(error, socket.gaierror) and error.errno == socket.EAI_AGAIN):
                return 'which is not a known machine'
    return ''


def _fault_of_profile(path: Path) -> str:
    """Return the reason why Fast DDS would ignore a profile file; empty if none."""
    if not path.is_file():
        return 'which is not a file'
    try:
        root = ElementTree.parse(path).getroot()
    except OSError as error:
        return f'which cannot be read ({error.strerror})'
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        return f'which is not XML ({error})'
    tag = root.tag.rpartition('}')[2]
    return '' if tag in ('dds', 'profiles') else f'which holds <{tag}> instead of <profiles>'


def _fault_that_fast_dds_finds() -> str:
    """Return the first error that Fast DDS reports for its profile file; empty if none."""
    output = subprocess.run(
        [sys.executable, '-c', _LOADS_PROFILES],
        env={**os.environ, RANGE: 'OFF'},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        check=False,
    ).stdout.decode('utf-8', 'replace')
    found = _FAULT.search(_COLOUR.sub('', output))
    return f'which Fast DDS cannot use ({found[1]})' if found else ''
