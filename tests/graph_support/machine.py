"""A machine whose time is set and whose disk is slow, as the processes see it that use it."""

from pathlib import Path
import struct
import subprocess

_SOURCE = Path(__file__).with_suffix('.c')
_NS, _US = 10**9, 10**6


class Machine:
    """
    What processes believe of their machine.

    :ivar environment: of the processes.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        library, self._file = folder / 'machine.so', folder / 'machine'
        subprocess.run(['gcc', '-shared', '-fPIC', '-O1', '-o', library, _SOURCE], check=True)
        self.environment = {'LD_PRELOAD': str(library), 'MACHINE': str(self._file)}
        self._file.write_bytes(bytes(16))
        self._ahead = self._wait = 0.0

    def set_time(self, seconds: float) -> None:
        """Set the time of day forward or back."""
        self._ahead += seconds
        self._write()

    def slow_disk(self, seconds: float) -> None:
        """Let each write to a file, and each wait for the disk, take longer."""
        self._wait = seconds
        self._write()

    def _write(self) -> None:
        data = struct.pack('=qq', int(self._ahead * _NS), int(self._wait * _US))
        with self._file.open('r+b') as file:
            file.write(data)
