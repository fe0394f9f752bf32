"""A folder that one process holds, and files that appear in it as a whole or not at all."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path
from types import TracebackType
from typing import Self

from service.store.errors import DiskError, StoreError

LOCK_NAME = "lock"
PARTIAL = ".partial-"  # how a file that is being written begins
PROBE_BYTES = 2**16


class HeldFolder:
    """A folder that belongs to this process until it ends, however it ends; what was half-written in it is removed.

    Raises:
        StoreError: another process holds it, or it cannot be written.

    Attributes:
        trouble: why a file could not be written the last time; empty where it could.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.trouble = ""
        try:
            path.mkdir(parents=True, exist_ok=True, mode=0o700)
            self._lock = os.open(path / LOCK_NAME, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        except OSError as error:
            raise StoreError(f"{path}: cannot be used as a folder of the store ({error.strerror})") from None
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(self._lock)
            raise StoreError(f"{path}: is in use by another server; stop it, or give this one its own folder") from None
        for left in path.glob(f"{PARTIAL}*"):
            left.unlink()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Let another process have the folder."""
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1

    def files(self) -> tuple[Path, ...]:
        """All files in it but its own."""
        return tuple(path for path in self.path.iterdir() if path.is_file() and path.name != LOCK_NAME)

    def write(self, name: str, data: bytes) -> None:
        """Put a file there; a reader sees all of it or none.

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
            raise self.failed(name, error) from None

    def failed(self, name: str, error: OSError) -> DiskError:
        """Note that a file could not be written; what to raise."""
        self.trouble = f"{self.path / name}: cannot be written ({error.strerror})"
        return DiskError(self.trouble)

    def probe(self) -> None:
        """Write a file and remove it; where that can be done, there is no trouble any more.

        Raises:
            DiskError: it still cannot be written.
        """
        name = f"{PARTIAL}probe"
        self.write(name, bytes(PROBE_BYTES))
        (self.path / name).unlink(missing_ok=True)
        self.trouble = ""
