"""Files that a server sends, written into a result folder and nowhere else."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from types import TracebackType
from typing import BinaryIO, Self

import grpc

from service.client.errors import PlannerError
from service.errors import ResultError, shown
from service.proto.planner.v1.result_pb2 import FileChunk
from service.result.folder import WRITTEN, check_folder, replace_folder

MAX_FILES = 5000
MAX_BYTES = 1 * 2**30  # of all files together
MAX_NAME_BYTES = 255
MAX_DEPTH = 20
_NAME = re.compile(r"[^/\\:\x00-\x1f\x7f]+")


class ReceivedFiles:
    """Writer of chunks, file after file.

    Args:
        folder: empty folder in which nothing else writes.
    """

    def __init__(self, folder: Path, max_files: int = MAX_FILES, max_bytes: int = MAX_BYTES) -> None:
        self._folder = folder
        self._max_files = max_files
        self._max_bytes = max_bytes
        self._seen: set[str] = set()
        self._n_bytes = 0
        self._open: tuple[str, BinaryIO] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._close()

    @property
    def any(self) -> bool:
        """Whether a file was received."""
        return bool(self._seen)

    def take(self, chunk: FileChunk) -> None:
        """Write a chunk.

        Raises:
            PlannerError: its file cannot be in a result folder, or the files are too large.
        """
        if self._open is None:
            self._open = chunk.path, self._create(chunk.path)
        path, file = self._open
        if chunk.path != path:
            raise _broken_answer(f"file {shown(path)} was cut off by {shown(chunk.path)}")
        self._n_bytes += len(chunk.data)
        if self._n_bytes > self._max_bytes:
            raise _broken_answer(f"the files have more than {self._max_bytes} bytes")
        file.write(chunk.data)
        if chunk.is_last:
            self._close()

    def read(self, path: str) -> bytes | None:
        """Return a received file; None if there is none of that path."""
        return (self._folder / PurePosixPath(path)).read_bytes() if path in self._seen else None

    def finish(self) -> None:
        """
        Raises:
            PlannerError: a file was cut off.
        """
        if self._open is not None:
            raise _broken_answer(f"file {shown(self._open[0])} was cut off")

    def restart(self) -> None:
        """Remove what was written, because the server starts again."""
        self._close()
        self._seen.clear()
        self._n_bytes = 0
        for entry in self._folder.iterdir():
            shutil.rmtree(entry) if entry.is_dir() else entry.unlink()

    def _create(self, path: str) -> BinaryIO:
        names = path.split("/")
        if names[0] not in WRITTEN or not all(map(_is_name, names)):
            raise _broken_answer(f"file {shown(path)} has no place in a result folder")
        if len(names) > MAX_DEPTH or len(self._seen) >= self._max_files:
            raise _broken_answer(
                f"more than {self._max_files} files, or deeper than {MAX_DEPTH} folders, at {shown(path)}"
            )
        target = self._folder / PurePosixPath(path)
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            file = target.open("xb")
        except (FileExistsError, NotADirectoryError):
            raise _broken_answer(f"file {shown(path)} was sent twice, or into another file") from None
        self._seen.add(path)
        return file

    def _close(self) -> None:
        if self._open is not None:
            self._open[1].close()
            self._open = None


@contextmanager
def receive_files(folder: Path | None) -> Iterator[ReceivedFiles | None]:
    """Yield the writer of a folder's files; they replace the folder together at the end of the body, if any came.

    Raises:
        ResultError: the folder holds something other than an earlier result, or cannot be written.
    """
    if folder is None:
        yield None
        return
    check_folder(folder)
    try:
        with replace_folder(folder) as fresh, ReceivedFiles(fresh) as files:
            yield files
            files.finish()
    except OSError as error:
        raise ResultError(f"{folder} cannot be written: {error.strerror or error}") from None


def _is_name(name: str) -> bool:
    """Whether a part of a path is the plain name of a file or folder."""
    return _NAME.fullmatch(name) is not None and name not in (".", "..") and len(name.encode()) <= MAX_NAME_BYTES


def _broken_answer(text: str) -> PlannerError:
    return PlannerError(grpc.StatusCode.DATA_LOSS, f"the server's answer is broken: {text}")
