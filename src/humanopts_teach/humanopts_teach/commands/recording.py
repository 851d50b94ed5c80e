"""Options of every launch that say what goes into the bag, and in how many files."""

import argparse

from humanopts_ros.recording import MOST_BYTES

_UNITS = {'': 1, 'k': 10**3, 'M': 10**6, 'G': 10**9}


def add_recording_options(command: argparse.ArgumentParser) -> None:
    """Add the options to a command."""
    for name, what in (
        ('include', 'record only topics like this, such as lesson/*'),
        ('exclude', 'do not record topics like this'),
    ):
        command.add_argument(
            f'--record-{name}',
            action='append',
            default=[],
            metavar='PATTERN',
            help=f'{what}; may be repeated',
        )
    command.add_argument(
        '--split-bytes',
        type=_size,
        default=0,
        metavar='SIZE',
        help='go on in another file of the bag at this size, such as 500M; default: never',
    )
    command.add_argument(
        '--split-seconds',
        type=_seconds,
        default=0.0,
        metavar='SECONDS',
        help='and after this time; default: never',
    )


def _size(text: str) -> int:
    digits = text.rstrip('kMG')
    unit = _UNITS.get(text[len(digits) :])
    size = int(digits) * unit if unit and digits.isascii() and digits.isdigit() else 0
    if not 0 < size <= MOST_BYTES:
        raise argparse.ArgumentTypeError(f'{text!r} is not a size such as 500M')
    return size


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 < value <= 10**6:
        raise argparse.ArgumentTypeError(f'{text!r} is not a number of seconds up to 1000000')
    return value
