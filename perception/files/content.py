"""Content of a file: read at once if small, otherwise memory-mapped."""

from __future__ import annotations

import io
import mmap
from pathlib import Path
from typing import IO, Any

from perception.limits import MAX_WHOLE_BYTES

Content = bytes | mmap.mmap


def open_content(path: Path) -> Content:
    """Return the file's content as ``bytes`` or ``mmap``; both support find, slices and the buffer protocol."""
    if path.stat().st_size <= MAX_WHOLE_BYTES:
        return path.read_bytes()
    with path.open("rb") as file:
        return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)


def open_stream(content: Content) -> IO[bytes]:
    """Return the content as a readable binary stream."""
    return io.BytesIO(content) if isinstance(content, bytes) else io.BufferedReader(_Mapped(content))


class _Mapped(io.RawIOBase):
    """A mapped file as a stream: ``mmap`` itself has no ``seekable`` and ``readinto`` in all versions of Python."""

    def __init__(self, content: mmap.mmap) -> None:
        self._content = content
        self._at = 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def readinto(self, target: Any) -> int:
        view = memoryview(target).cast("B")
        block = self._content[self._at : self._at + len(view)]
        view[: len(block)] = block
        self._at += len(block)
        return len(block)

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        start = {io.SEEK_SET: 0, io.SEEK_CUR: self._at, io.SEEK_END: len(self._content)}[whence]
        if start + offset < 0:
            raise ValueError(f"seek to {start + offset}; the start of the file is 0")
        self._at = start + offset
        return self._at

    def tell(self) -> int:
        return self._at
