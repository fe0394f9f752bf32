"""Uploaded cloud files: each kept once under the hash of its content, those used least recently going first."""

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
from service.store.folder import PARTIAL, HeldFolder

# Kinds of one file each (perception.files reads folders too), spelt out: the front of a server loads no readers.
CLOUD_SUFFIXES = (
    ".pcd", ".ply", ".xyz", ".txt", ".csv", ".asc", ".pts", ".xyzn", ".xyzi", ".xyzrgb", ".ptx", ".npz", ".npy", ".las",
    ".laz", ".e57", ".mcap", ".db3", ".bag",
)  # fmt: skip
# A cloud, a scene that was made of one, or a mesh; .ply may be either of the last.
UPLOAD_SUFFIXES = (*CLOUD_SUFFIXES, ".json", *(suffix for suffix in MESH_SUFFIXES if suffix not in CLOUD_SUFFIXES))
CLOUD_ID = re.compile(rf"sha256:[0-9a-f]{{64}}({'|'.join(re.escape(suffix) for suffix in UPLOAD_SUFFIXES)})")


@dataclass(frozen=True)
class CloudLimits:
    """How much is kept, and how much may be on its way, at most."""

    max_bytes: int = 4 * 2**30
    max_cloud_bytes: int = 64 * 2**20
    max_uploads: int = 16
    max_uploads_per_client: int = 2


@dataclass(frozen=True)
class CloudStats:
    """How full the folder is; ``n_bytes`` counts uploads on their way too."""

    n_clouds: int
    n_bytes: int
    n_uploads: int


class CloudStore:
    """A folder of clouds; used from any thread.  Opening it takes the folder for this process alone.

    A cloud's id is its file's name: ``sha256:``, the hash of its content, and the suffix that tells its kind.

    Raises:
        StoreError: the folder is in use or cannot be read.
    """

    def __init__(self, folder: Path, limits: CloudLimits | None = None) -> None:
        self.limits = limits or CloudLimits()
        self._folder = HeldFolder(folder)
        self._turn = threading.Lock()
        files = [(file.stat(), file.name) for file in self._folder.files() if CLOUD_ID.fullmatch(file.name)]
        files.sort(key=lambda file: file[0].st_mtime_ns)
        self._bytes = OrderedDict((name, stat.st_size) for stat, name in files)  # least recently used first
        self._used = Counter[str]()
        self._uploads = Counter[str]()
        self._arriving = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Let another process have the folder."""
        self._folder.close()

    def upload(self, client: str, suffix: str) -> Upload:
        """Begin to take a cloud in; the upload is closed by the caller, whatever happens.

        Raises:
            UploadRefusedError: no cloud files have this suffix.
            StoreFullError: too many uploads are on their way.
        """
        suffix = suffix.lower()
        if suffix not in UPLOAD_SUFFIXES:
            raise UploadRefusedError(f"suffix {shown(suffix)} is unknown; {', '.join(UPLOAD_SUFFIXES)} would do")
        limits = self.limits
        with self._turn:
            if self._uploads[client] >= limits.max_uploads_per_client:
                raise StoreFullError(f"{limits.max_uploads_per_client} uploads of this client are on their way already")
            if self._uploads.total() >= limits.max_uploads:
                raise StoreFullError(f"{limits.max_uploads} uploads are on their way already")
            self._uploads[client] += 1
        try:
            return Upload(self, client, suffix, self._folder.path / f"{PARTIAL}{secrets.token_hex(8)}")
        except BaseException:
            self._leave(client, 0)
            raise

    @contextlib.contextmanager
    def using(self, cloud_ids: Iterable[str]) -> Iterator[Mapping[str, Path]]:
        """The files of clouds by id; they stay while the body runs.

        Raises:
            NotStoredError: naming the first that is not there.
        """
        ids = tuple(dict.fromkeys(cloud_ids))
        with self._turn:
            for cloud_id in ids:
                if not self._is_there(cloud_id):
                    raise NotStoredError(f"no cloud {shown(cloud_id)}; upload it first, or again")
            for cloud_id in ids:
                self._used[cloud_id] += 1
                self._touch(cloud_id)
        try:
            yield {cloud_id: self._folder.path / cloud_id for cloud_id in ids}
        finally:
            with self._turn:
                self._used.subtract(ids)
                self._used = +self._used

    def has(self, cloud_id: str) -> bool:
        """Whether a cloud is there."""
        with self._turn:
            return self._is_there(cloud_id)

    def size(self, cloud_id: str) -> int | None:
        """Bytes of a cloud; None where it is not there."""
        with self._turn:
            return self._bytes[cloud_id] if self._is_there(cloud_id) else None

    def stats(self) -> CloudStats:
        """How full the folder is."""
        with self._turn:
            n_bytes = sum(self._bytes.values()) + self._arriving
            return CloudStats(len(self._bytes), n_bytes, self._uploads.total())

    @property
    def trouble(self) -> str:
        """Why a cloud could not be written the last time; empty where it could."""
        return self._folder.trouble

    def probe(self) -> None:
        """Find out whether clouds can be written again.

        Raises:
            DiskError: they still cannot.
        """
        self._folder.probe()

    def _arrive(self, n_bytes: int) -> None:
        """Room for more bytes of an upload.

        Raises:
            StoreFullError: what is in use leaves none.
        """
        with self._turn:
            over = sum(self._bytes.values()) + self._arriving + n_bytes - self.limits.max_bytes
            for cloud_id in [one for one in self._bytes if not self._used[one]] if over > 0 else ():
                (self._folder.path / cloud_id).unlink(missing_ok=True)
                over -= self._bytes.pop(cloud_id)
                if over <= 0:
                    break
            if over > 0:
                raise StoreFullError(f"the clouds in use leave no room for {n_bytes} more bytes")
            self._arriving += n_bytes

    def _keep(self, partial: Path, cloud_id: str) -> None:
        with self._turn:
            if self._is_there(cloud_id):
                partial.unlink()
                self._touch(cloud_id)
            else:
                n_bytes = partial.stat().st_size
                partial.rename(self._folder.path / cloud_id)
                self._bytes[cloud_id] = n_bytes

    def _leave(self, client: str, n_bytes: int) -> None:
        with self._turn:
            self._uploads[client] -= 1
            self._uploads = +self._uploads
            self._arriving -= n_bytes

    def _is_there(self, cloud_id: str) -> bool:
        if cloud_id in self._bytes and not (self._folder.path / cloud_id).is_file():  # somebody tidied up
            del self._bytes[cloud_id]
        return cloud_id in self._bytes

    def _touch(self, cloud_id: str) -> None:
        self._bytes.move_to_end(cloud_id)
        os.utime(self._folder.path / cloud_id)


class Upload:
    """One cloud on its way in: chunks, then ``finish``; closed without it, nothing stays.

    It may be closed while another thread writes: what was written is forgotten as soon as that has ended.
    """

    def __init__(self, store: CloudStore, client: str, suffix: str, partial: Path) -> None:
        self._store = store
        self._client = client
        self._suffix = suffix
        self._partial = partial
        self._hash = hashlib.sha256()
        self._turn = threading.Lock()
        self._shall_close = self._is_closed = False
        self.n_bytes = 0
        try:
            self._file = partial.open("xb")
        except OSError as error:
            raise store._folder.failed(partial.name, error) from None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def write(self, chunk: bytes) -> None:
        """Take the next bytes.

        Raises:
            TooLargeError: the cloud has more bytes than one may have.
            StoreFullError: there is no room for it now.
            DiskError: it cannot be written; StoreError: it is closed.
        """
        with self._taking_turn():
            limit = self._store.limits.max_cloud_bytes
            if self.n_bytes + len(chunk) > limit:
                raise TooLargeError(f"the cloud has more than {limit} bytes; downsample it first")
            self._store._arrive(len(chunk))
            self.n_bytes += len(chunk)
            self._hash.update(chunk)
            self._file.write(chunk)

    @property
    def sha256(self) -> str:
        """Of what came so far."""
        return self._hash.hexdigest()

    def finish(self) -> str:
        """Keep what came, and close; returns the cloud's id.

        Raises:
            UploadRefusedError: nothing came.
            DiskError: it cannot be written; StoreError: it is closed.
        """
        self._shall_close = True
        with self._taking_turn():
            if not self.n_bytes:
                raise UploadRefusedError("the cloud is empty; a file with at least one point is needed")
            cloud_id = f"sha256:{self.sha256}{self._suffix}"
            self._file.flush()
            os.fsync(self._file.fileno())
            self._store._keep(self._partial, cloud_id)
        return cloud_id

    def close(self) -> None:
        """Forget what came, unless it was finished."""
        self._shall_close = True
        if self._turn.acquire(blocking=False):  # or else whoever has the turn sees to it
            try:
                self._forget()
            finally:
                self._turn.release()

    @contextlib.contextmanager
    def _taking_turn(self) -> Iterator[None]:
        try:
            with self._turn:
                if self._is_closed:
                    raise StoreError("the upload is closed")
                yield
        except OSError as error:
            raise self._store._folder.failed(self._partial.name, error) from None
        finally:
            if self._shall_close:
                self.close()

    def _forget(self) -> None:
        if self._is_closed:
            return
        self._is_closed = True
        with contextlib.suppress(OSError):  # a full disk was told of before
            self._file.close()
        self._partial.unlink(missing_ok=True)
        self._store._leave(self._client, self.n_bytes)
