"""What other processes write to their standard error: logged by this one, line by line, its end kept."""

from __future__ import annotations

import logging
import os

_CHUNK = 2**16
_MAX_LINE = 2000
_TAIL = 1000


class Chatter:
    """The reading end of a pipe, and what came out of it.

    Attributes:
        who: named in the log.
    """

    def __init__(self, log: logging.Logger, who: str) -> None:
        self._log = log
        self.who = who
        self._line = b""
        self._tail = b""
        self.fd, self.write_fd = os.pipe()
        os.set_blocking(self.fd, False)

    @property
    def tail(self) -> str:
        """The end of what was said."""
        return self._tail.decode(errors="replace").strip()

    def read(self) -> bool:
        """Log what is there; False when there will be no more."""
        try:
            data = os.read(self.fd, _CHUNK)
        except BlockingIOError:
            return True
        self._tail = (self._tail + data)[-_TAIL:]
        *lines, self._line = (self._line + data).split(b"\n")
        if len(self._line) > _MAX_LINE or not data:
            lines, self._line = [*lines, self._line], b""
        for line in lines:
            if line.strip():
                self._log.info("%s: %s", self.who, line[:_MAX_LINE].decode(errors="replace").rstrip())
        return bool(data)

    def hand_over(self) -> None:
        """Close the writing end, which another process has by now."""
        if self.write_fd >= 0:
            os.close(self.write_fd)
            self.write_fd = -1

    def close(self) -> None:
        """Log what is left and be done."""
        self.hand_over()
        self.read()
        os.close(self.fd)
