"""Files that a server sends, put into a folder that only what was sent can be in."""

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
from service.result.folder import WRITTEN, check_folder, replaced

MAX_FILES = 5000
MAX_BYTES = 1 * 2**30  # of all files together
MAX_NAME_BYTES = 255
_STEP = re.compile(r"[^/\\:\x00-\x1f\x7f]+")


class ReceivedFiles:
    """Takes chunks in as they come, file after file; ``restart`` when the server begins anew.

    Args:
        folder: an empty one, in which nobody else writes.
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
        """Whether a file has come."""
        return bool(self._seen)

    def take(self, chunk: FileChunk) -> None:
        """Write a chunk.

        Raises:
            PlannerError: it belongs to no file that a result folder has, or is too much.
        """
        if self._open is None:
            self._open = chunk.path, self._new(chunk.path)
        path, file = self._open
        if chunk.path != path:
            raise _broken(f"file {shown(path)} was cut off by {shown(chunk.path)}")
        self._n_bytes += len(chunk.data)
        if self._n_bytes > self._max_bytes:
            raise _broken(f"the files have more than {self._max_bytes} bytes")
        file.write(chunk.data)
        if chunk.is_last:
            self._close()

    def finish(self) -> None:
        """
        Raises:
            PlannerError: a file was cut off.
        """
        if self._open is not None:
            raise _broken(f"file {shown(self._open[0])} was cut off")

    def restart(self) -> None:
        """Forget what came: the server begins again."""
        self._close()
        self._seen.clear()
        self._n_bytes = 0
        for entry in self._folder.iterdir():
            shutil.rmtree(entry) if entry.is_dir() else entry.unlink()

    def _new(self, path: str) -> BinaryIO:
        steps = path.split("/")
        if steps[0] not in WRITTEN or not all(_is_name(step) for step in steps):
            raise _broken(f"file {shown(path)} has no place in a result folder")
        if len(steps) > 20 or len(self._seen) >= self._max_files:
            raise _broken(f"more than {self._max_files} files, or deeper than 20 folders, at {shown(path)}")
        target = self._folder / PurePosixPath(path)
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            file = target.open("xb")
        except (FileExistsError, NotADirectoryError):
            raise _broken(f"file {shown(path)} was sent twice, or into another file") from None
        self._seen.add(path)
        return file

    def _close(self) -> None:
        if self._open is not None:
            self._open[1].close()
            self._open = None


@contextmanager
def received_files(folder: Path | None) -> Iterator[ReceivedFiles | None]:
    """Where the files for ``folder`` go; they take its place as a whole when the body succeeds, if any came.

    Raises:
        ResultError: the folder holds something other than an earlier result, or cannot be written.
    """
    if folder is None:
        yield None
        return
    check_folder(folder)
    try:
        with replaced(folder) as fresh, ReceivedFiles(fresh) as files:
            yield files
            files.finish()
    except OSError as error:
        raise ResultError(f"{folder} cannot be written: {error.strerror or error}") from None


def _is_name(step: str) -> bool:
    """Whether a step of a path is the plain name of a file or folder."""
    return _STEP.fullmatch(step) is not None and step not in (".", "..") and len(step.encode()) <= MAX_NAME_BYTES


def _broken(text: str) -> PlannerError:
    return PlannerError(grpc.StatusCode.DATA_LOSS, f"the server's answer is not one: {text}")
