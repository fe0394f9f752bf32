"""Uploaded files, each stored once under the hash of its content; the least recently used are deleted first."""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import secrets
import threading
from collections import Counter, OrderedDict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from service.errors import shown
from service.request.scene import MESH_SUFFIXES
from service.store.errors import NotStoredError, StoreError, StoreFullError, TooLargeError, UploadRefusedError
from service.store.folder import PARTIAL, LockedFolder
from service.store.seals import hash_file

# Formats of single files (perception.files reads folders too), listed here because the server loads no readers.
CLOUD_SUFFIXES = (
    ".pcd", ".ply", ".xyz", ".txt", ".csv", ".asc", ".pts", ".xyzn", ".xyzi", ".xyzrgb", ".ptx", ".npz", ".npy",
    ".las", ".laz", ".e57", ".vtk", ".vtp", ".vtu", ".vts", ".png", ".mcap", ".db3", ".bag",
)  # fmt: skip
# Clouds, scene files and meshes; a .ply may be a cloud or a mesh.
UPLOAD_SUFFIXES = (*CLOUD_SUFFIXES, ".json", *(suffix for suffix in MESH_SUFFIXES if suffix not in CLOUD_SUFFIXES))
CLOUD_ID = re.compile(rf"sha256:[0-9a-f]{{64}}({'|'.join(re.escape(suffix) for suffix in UPLOAD_SUFFIXES)})")


@dataclass(frozen=True)
class CloudLimits:
    """Limits of stored files and of open uploads."""

    max_bytes: int = 4 * 2**30
    max_cloud_bytes: int = 64 * 2**20
    max_uploads: int = 16
    max_uploads_per_client: int = 2


@dataclass(frozen=True)
class CloudStats:
    """Number and size of the stored files; ``n_bytes`` includes open uploads."""

    n_clouds: int
    n_bytes: int
    n_uploads: int


class CloudStore:
    """A folder of uploads, for use from any thread.  The folder belongs to one process at a time.

    An upload's id is its file's name: ``sha256:``, the hash of its content, and the suffix of its format.

    Raises:
        StoreError: the folder is in use or cannot be read.
    """

    def __init__(self, folder: Path, limits: CloudLimits | None = None) -> None:
        self.limits = limits or CloudLimits()
        self._folder = LockedFolder(folder)
        self._lock = threading.Lock()
        files = [(file.stat(), file.name) for file in self._folder.files() if CLOUD_ID.fullmatch(file.name)]
        files.sort(key=lambda file: file[0].st_mtime_ns)
        self._bytes = OrderedDict((name, stat.st_size) for stat, name in files)  # least recently used first
        self._users = Counter[str]()  # by id
        self._uploads = Counter[str]()  # by client
        self._upload_bytes = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Release the folder for other processes."""
        self._folder.close()

    def upload(self, client: str, suffix: str) -> Upload:
        """Open an upload, which the caller closes.

        Raises:
            UploadRefusedError: unknown suffix.
            StoreFullError: too many open uploads.
        """
        suffix = suffix.lower()
        if suffix not in UPLOAD_SUFFIXES:
            raise UploadRefusedError(f"unknown suffix {shown(suffix)}; expected {', '.join(UPLOAD_SUFFIXES)}")
        limits = self.limits
        with self._lock:
            if self._uploads[client] >= limits.max_uploads_per_client:
                raise StoreFullError(f"this client has {limits.max_uploads_per_client} open uploads already")
            if self._uploads.total() >= limits.max_uploads:
                raise StoreFullError(f"the server has {limits.max_uploads} open uploads already")
            self._uploads[client] += 1
        try:
            return Upload(self, client, suffix, self._folder.path / f"{PARTIAL}{secrets.token_hex(8)}")
        except BaseException:
            self._end_upload(client, 0)
            raise

    @contextlib.contextmanager
    def open_files(self, cloud_ids: Iterable[str]) -> Iterator[Mapping[str, Path]]:
        """Yield the paths of uploads by id; they are not deleted during the body.

        Raises:
            NotStoredError: names the first id that is not stored.
        """
        ids = tuple(dict.fromkeys(cloud_ids))
        with self._lock:
            for cloud_id in ids:
                if not self._is_stored(cloud_id):
                    raise NotStoredError(f"no cloud {shown(cloud_id)} is stored; upload it first, or again")
            for cloud_id in ids:
                self._users[cloud_id] += 1
                self._touch(cloud_id)
        try:
            yield {cloud_id: self._folder.path / cloud_id for cloud_id in ids}
        finally:
            with self._lock:
                self._users.subtract(ids)
                self._users = +self._users

    def has(self, cloud_id: str) -> bool:
        """Return whether an upload is stored."""
        with self._lock:
            return self._is_stored(cloud_id)

    def size(self, cloud_id: str) -> int | None:
        """Return the size of an upload [bytes]; None if it is not stored."""
        with self._lock:
            return self._bytes[cloud_id] if self._is_stored(cloud_id) else None

    def check(self, cloud_id: str) -> bool:
        """Return whether an upload is stored with the content that its id names; a damaged one is removed."""
        if not self.has(cloud_id):
            return False
        is_sound = _is_sound(self._folder.path / cloud_id)
        if not is_sound:
            self.discard(cloud_id)
        return is_sound

    def discard(self, cloud_id: str) -> None:
        """Remove an upload whose content is damaged."""
        with self._lock:
            if self._bytes.pop(cloud_id, None) is not None:
                (self._folder.path / cloud_id).unlink(missing_ok=True)

    def stats(self) -> CloudStats:
        """Return number and size of the stored files."""
        with self._lock:
            n_bytes = sum(self._bytes.values()) + self._upload_bytes
            return CloudStats(len(self._bytes), n_bytes, self._uploads.total())

    @property
    def write_error(self) -> str:
        """Reason why the last write failed; empty if it succeeded."""
        return self._folder.write_error

    def probe(self) -> None:
        """Write to the folder, and clear ``write_error`` if that succeeds.

        Raises:
            DiskError: it cannot be written.
        """
        self._folder.probe()

    def _reserve(self, n_bytes: int) -> None:
        """Make space for more bytes of an upload.

        Raises:
            StoreFullError: the files in use leave too little.
        """
        with self._lock:
            over = sum(self._bytes.values()) + self._upload_bytes + n_bytes - self.limits.max_bytes
            for cloud_id in [stored for stored in self._bytes if not self._users[stored]] if over > 0 else ():
                (self._folder.path / cloud_id).unlink(missing_ok=True)
                over -= self._bytes.pop(cloud_id)
                if over <= 0:
                    break
            if over > 0:
                raise StoreFullError(f"the clouds in use leave no space for {n_bytes} more bytes")
            self._upload_bytes += n_bytes

    def _add(self, partial: Path, cloud_id: str) -> None:
        with self._lock:
            n_bytes = partial.stat().st_size
            partial.rename(self._folder.path / cloud_id)  # also over a stored file, which may be damaged
            self._bytes[cloud_id] = n_bytes
            self._touch(cloud_id)

    def _end_upload(self, client: str, n_bytes: int) -> None:
        with self._lock:
            self._uploads[client] -= 1
            self._uploads = +self._uploads
            self._upload_bytes -= n_bytes

    def _is_stored(self, cloud_id: str) -> bool:
        if cloud_id in self._bytes and not (self._folder.path / cloud_id).is_file():  # deleted by another program
            del self._bytes[cloud_id]
        return cloud_id in self._bytes

    def _touch(self, cloud_id: str) -> None:
        self._bytes.move_to_end(cloud_id)
        os.utime(self._folder.path / cloud_id)


class Upload:
    """An open upload: chunks, then ``finish``; without it ``close`` deletes the chunks.

    It may be closed while another thread writes; the chunks are deleted as soon as that write has ended.
    """

    def __init__(self, store: CloudStore, client: str, suffix: str, partial: Path) -> None:
        self._store = store
        self._client = client
        self._suffix = suffix
        self._partial = partial
        self._hash = hashlib.sha256()
        self._lock = threading.Lock()
        self._shall_close = self._is_closed = False
        self.n_bytes = 0
        try:
            self._file = partial.open("xb")
        except OSError as error:
            raise store._folder.record_error(partial.name, error) from None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def write(self, chunk: bytes) -> None:
        """Append a chunk.

        Raises:
            TooLargeError: the upload exceeds the limit of a file.
            StoreFullError: there is no space for it now.
            DiskError: it cannot be written.
            StoreError: the upload is closed.
        """
        with self._lock_open():
            limit = self._store.limits.max_cloud_bytes
            if self.n_bytes + len(chunk) > limit:
                raise TooLargeError(f"the cloud has more than {limit} bytes; downsample it first")
            self._store._reserve(len(chunk))
            self.n_bytes += len(chunk)
            self._hash.update(chunk)
            self._file.write(chunk)

    @property
    def sha256(self) -> str:
        """Hash of the chunks so far."""
        return self._hash.hexdigest()

    def finish(self) -> str:
        """Store the file and close; returns its id.

        Raises:
            UploadRefusedError: there are no bytes.
            DiskError: it cannot be written.
            StoreError: the upload is closed.
        """
        self._shall_close = True
        with self._lock_open():
            if not self.n_bytes:
                raise UploadRefusedError("the cloud is empty; expected a file with at least one point")
            cloud_id = f"sha256:{self.sha256}{self._suffix}"
            self._file.flush()
            os.fsync(self._file.fileno())
            self._store._add(self._partial, cloud_id)
        return cloud_id

    def close(self) -> None:
        """Delete the chunks unless the upload was finished."""
        self._shall_close = True
        if self._lock.acquire(blocking=False):  # otherwise the thread that holds the lock closes the upload
            try:
                self._delete()
            finally:
                self._lock.release()

    @contextlib.contextmanager
    def _lock_open(self) -> Iterator[None]:
        try:
            with self._lock:
                if self._is_closed:
                    raise StoreError("the upload is closed")
                yield
        except OSError as error:
            raise self._store._folder.record_error(self._partial.name, error) from None
        finally:
            if self._shall_close:
                self.close()

    def _delete(self) -> None:
        if self._is_closed:
            return
        self._is_closed = True
        with contextlib.suppress(OSError):  # a full disk was reported by the write
            self._file.close()
        self._partial.unlink(missing_ok=True)
        self._store._end_upload(self._client, self.n_bytes)


def find_damaged_uploads(paths: Iterable[str]) -> tuple[str, ...]:
    """Return the ids of uploads among paths whose content is not the one that the id names.

    The name of an upload's file is its id; other files are left out.
    """
    names = dict.fromkeys(path for path in paths if CLOUD_ID.fullmatch(Path(path).name))
    return tuple(Path(path).name for path in names if not _is_sound(Path(path)))


def _is_sound(path: Path) -> bool:
    try:
        return hash_file(path) == _hash_of(path.name)
    except OSError:
        return False


def _hash_of(cloud_id: str) -> str:
    return cloud_id.partition(":")[2].partition(".")[0]
