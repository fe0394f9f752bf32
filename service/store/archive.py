"""Archives of plans: files that are compared with their hash before they are read and while they are read."""

from __future__ import annotations

import hashlib
import io
import os
import stat
from pathlib import Path

from service.store.errors import DamagedError
from service.store.seals import CHUNK_BYTES


class PlanArchive(io.RawIOBase):
    """The archive of a plan, to be read from its first byte to its last.

    It is compared with its hash when it is opened, so that nothing of a damaged one is read, and ``finish`` compares
    what was read, since the file may have changed meanwhile.

    Args:
        path: path of the file; its name is the plan's id.
        size: its size [bytes].
        sha256: its hash as hexadecimals.

    Raises:
        OSError: it cannot be opened.
        DamagedError: it is not what was stored.
    """

    def __init__(self, path: Path, size: int, sha256: str) -> None:
        super().__init__()
        self._name, self._size, self._sha256 = path.name, size, sha256
        # What has taken the file's place may be a pipe or a device, which would never end.
        self._fd = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            status = os.fstat(self._fd)
            if not stat.S_ISREG(status.st_mode) or status.st_size != size:
                raise self._damage()
            self._restart()
            self.finish()
            self._restart()
        except BaseException:
            self.close()
            raise

    def readable(self) -> bool:
        """Return True."""
        return True

    def read(self, size: int | None = -1, /) -> bytes:
        """Return the next bytes, all of them without a size."""
        wanted = self._left if size is None or size < 0 else min(size, self._left)
        data = os.read(self._fd, wanted)
        self._left -= len(data)
        self._digest.update(data)
        return data

    def finish(self) -> None:
        """Read the rest.

        Raises:
            DamagedError: what was read is not what was stored.
        """
        while self._left and self.read(CHUNK_BYTES):
            pass
        if self._left or self._digest.hexdigest() != self._sha256:
            raise self._damage()

    def close(self) -> None:
        """Close the file."""
        if not self.closed:
            os.close(self._fd)
        super().close()

    def _restart(self) -> None:
        os.lseek(self._fd, 0, os.SEEK_SET)
        self._left, self._digest = self._size, hashlib.sha256()

    def _damage(self) -> DamagedError:
        return DamagedError(f"plan {self._name}: its files are damaged on this server's disk; plan it again")
