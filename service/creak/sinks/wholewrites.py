"""A file that a full disk leaves whole."""

import contextlib
import os
from pathlib import Path


class WholeWrites:
    """A file in which a write happens wholly or not at all, and nothing waits in a buffer.

    The MCAP writer hands over whole records, so the file ends with a whole record even on a full disk, and a later
    close has nothing left to fail on.

    Parameters
    ----------
    path : Path
    flag : int
        ``os.O_EXCL`` for a file that must not be there yet, ``os.O_TRUNC`` for one that is overwritten.
    """

    def __init__(self, path: Path, flag: int) -> None:
        self._path = path
        self._at = 0
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC | flag, 0o644)

    def write(self, data: bytes) -> int:
        """Append all of it, or raise OSError and leave the file as it was."""
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[os.write(self._descriptor, rest) :]
        except OSError:
            with contextlib.suppress(OSError):
                os.ftruncate(self._descriptor, self._at)
            raise
        self._at += len(data)
        return len(data)

    def tell(self) -> int:
        """Return the bytes written so far."""
        return self._at

    def flush(self) -> None:
        """Do nothing: what was written is with the operating system already."""

    def sync(self) -> None:
        """Have the disk hold what was written."""
        os.fsync(self._descriptor)

    def sync_name(self) -> None:
        """Have the disk hold the file's entry in its directory."""
        directory = os.open(self._path.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            os.fsync(directory)
        finally:
            os.close(directory)

    def close(self) -> None:
        """Close it; once more does no harm."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1
