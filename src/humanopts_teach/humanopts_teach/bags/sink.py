"""The file below an MCAP writer: it ends after a whole record, whatever happens."""

from contextlib import suppress
import os
from pathlib import Path

from humanopts_teach.bags.errors import BagWriteError


class Sink:
    """
    Writes whole MCAP records to a new file, unbuffered.

    A record that does not fit on the disk is taken back, so that the file stays readable; after
    that nothing more is written.
    """

    def __init__(self, path: Path) -> None:
        """
        Create the file.

        :raises OSError: it exists, or cannot be created.
        """
        self._path = path
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        self._end = 0
        self._failure = ''

    def write(self, data: bytes) -> None:
        """
        Append whole records.

        :raises BagWriteError: the disk is full, or the file cannot be written any more.
        """
        if self._failure:
            raise BagWriteError(self._failure)
        view = memoryview(data)
        try:
            while view:
                view = view[os.write(self._file, view) :]
        except OSError as error:
            self._failure = f'cannot write to {self._path}: {error.strerror}; what was written'
            self._failure += ' before is kept. Free space and start another recording'
            with suppress(OSError):
                os.ftruncate(self._file, self._end)
            raise BagWriteError(self._failure) from error
        self._end += len(data)

    def rename(self, path: Path) -> None:
        """
        Give the file another name.

        :raises OSError: it cannot have it.
        """
        os.replace(self._path, path)
        self._path = path

    def discard(self) -> None:
        """Close the file and remove it."""
        self.close()
        with suppress(OSError):
            self._path.unlink()

    def tell(self) -> int:
        """Return the size of the file."""
        return self._end

    def flush(self) -> None:
        """Do nothing: what was written is with the operating system already."""

    def close(self) -> None:
        """Close the file; it can be called again."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1
