"""A folder locked for one process, with files that are written completely or not at all."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path
from types import TracebackType
from typing import Self

from service.store.errors import DiskError, StoreError

LOCK_NAME = "lock"
PARTIAL = ".partial-"  # prefix of a file that is being written
PROBE_BYTES = 2**16


class LockedFolder:
    """A folder locked by this process until its end; partly written files are removed from it.

    Raises:
        StoreError: another process has locked it, or it cannot be written.

    Attributes:
        write_error: reason why the last write failed; empty if it succeeded.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.write_error = ""
        try:
            path.mkdir(parents=True, exist_ok=True, mode=0o700)
            self._lock = os.open(path / LOCK_NAME, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        except OSError as error:
            raise StoreError(f"{path}: cannot be used as a folder of the store ({error.strerror})") from None
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(self._lock)
            raise StoreError(f"{path}: in use by another server; stop it, or choose another folder") from None
        for left in path.glob(f"{PARTIAL}*"):
            left.unlink()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Release the folder for other processes."""
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1

    def files(self) -> tuple[Path, ...]:
        """Return all files of the folder but the lock."""
        return tuple(path for path in self.path.iterdir() if path.is_file() and path.name != LOCK_NAME)

    def write(self, name: str, data: bytes) -> None:
        """Write a file; a reader sees all of it or none.

        Raises:
            DiskError: it cannot be written.
        """
        partial = self.path / f"{PARTIAL}{name}"
        try:
            with partial.open("wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            partial.rename(self.path / name)
        except OSError as error:
            partial.unlink(missing_ok=True)
            raise self.record_error(name, error) from None

    def record_error(self, name: str, error: OSError) -> DiskError:
        """Set ``write_error``; returns the error to raise."""
        self.write_error = f"{self.path / name}: cannot be written ({error.strerror})"
        return DiskError(self.write_error)

    def probe(self) -> None:
        """Write a file and remove it, and clear ``write_error`` if that succeeds.

        Raises:
            DiskError: it cannot be written.
        """
        name = f"{PARTIAL}probe"
        self.write(name, bytes(PROBE_BYTES))
        (self.path / name).unlink(missing_ok=True)
        self.write_error = ""
