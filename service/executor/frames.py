"""What goes through the socket between pool and worker: frames of a kind, a job's number and a payload."""

from __future__ import annotations

import enum
import socket
import struct
from collections import deque
from collections.abc import Iterator
from typing import NamedTuple

MAX_FRAME_BYTES = 2**30
_HEADER = struct.Struct("<BQQ")  # kind, job, length of the payload
_CHUNK = 2**16
_MAX_SENT = 2**20  # at a time


class Kind(enum.IntEnum):
    """What a frame says."""

    SETUP = 1  # to the worker: what it needs to become ready
    RUN = 2  # to the worker: a call
    BORN = 3  # from the worker: its process id
    READY = 4
    UNREADY = 5  # why it did not become ready
    EVENT = 6  # what a job reports
    RETURNED = 7
    RAISED = 8


class Frame(NamedTuple):
    """One message; ``job`` is 0 where it is about none."""

    kind: Kind
    job: int
    payload: bytes


class BrokenFrameError(Exception):
    """What arrived is no frame: the other side is out of its mind."""


class Channel:
    """A worker's end: waits until a frame is through."""

    def __init__(self, sock: socket.socket) -> None:
        self._sock = sock

    def send(self, kind: Kind, job: int, payload: bytes) -> None:
        """Send a frame."""
        header = _HEADER.pack(kind, job, len(payload))
        if len(payload) < _CHUNK:
            self._sock.sendall(header + payload)  # at once: either wakes the other side
        else:
            self._sock.sendall(header)
            self._sock.sendall(payload)

    def receive(self) -> Frame | None:
        """The next frame, None when the other side is gone."""
        header = self._exactly(_HEADER.size)
        if header is None:
            return None
        kind, job, length = _HEADER.unpack(header)
        payload = self._exactly(length)
        return None if payload is None else Frame(Kind(kind), job, bytes(payload))

    def _exactly(self, n: int) -> bytearray | None:
        buffer = bytearray(n)
        view, filled = memoryview(buffer), 0
        while filled < n:
            got = self._sock.recv_into(view[filled:])
            if got == 0:
                return None
            filled += got
        return buffer


class Inbox:
    """The pool's end, reading: takes what is there and never waits for the rest of it."""

    def __init__(self, sock: socket.socket) -> None:
        self._sock = sock
        self._buffer = bytearray()
        self.is_closed = False

    def read(self, everything: bool = False) -> Iterator[Frame]:
        """Frames that are complete by now; ``is_closed`` says whether there will be no more.

        Args:
            everything: not only the first few, of which there may be more by the time they are read.

        Raises:
            BrokenFrameError: the bytes are no frame.
        """
        n_frames = 0
        while not self.is_closed and (everything or n_frames == 0):
            try:
                data = self._sock.recv(_CHUNK)
            except BlockingIOError:
                break
            except OSError:
                data = b""
            self.is_closed = not data
            self._buffer += data
            for frame in self._complete():
                n_frames += 1
                yield frame

    def _complete(self) -> Iterator[Frame]:
        while len(self._buffer) >= _HEADER.size:
            kind, job, length = _HEADER.unpack_from(self._buffer)
            if kind not in set(Kind) or length > MAX_FRAME_BYTES:
                raise BrokenFrameError(f"kind {kind}, {length} bytes")
            end = _HEADER.size + length
            if len(self._buffer) < end:
                return
            payload = bytes(memoryview(self._buffer)[_HEADER.size : end])
            del self._buffer[:end]
            yield Frame(Kind(kind), job, payload)


class Outbox:
    """The pool's end, writing: sends what the worker takes and keeps the rest."""

    def __init__(self, sock: socket.socket) -> None:
        self._sock = sock
        self._waiting: deque[memoryview] = deque()

    def put(self, frame: Frame) -> None:
        """Have a frame sent after those before it."""
        header = _HEADER.pack(frame.kind, frame.job, len(frame.payload))
        if len(frame.payload) < _CHUNK:
            self._waiting.append(memoryview(header + frame.payload))
        else:
            self._waiting += [memoryview(header), memoryview(frame.payload)]

    def flush(self) -> bool:
        """Send some of what can be sent without waiting; whether all is gone."""
        n_bytes = 0
        while self._waiting and n_bytes < _MAX_SENT:
            try:
                sent = self._sock.send(self._waiting[0])
            except BlockingIOError:
                return False
            except OSError:  # the worker is gone, which is noticed by what it no longer says
                self._waiting.clear()
                return True
            n_bytes += sent
            rest = self._waiting[0][sent:]
            if rest:
                self._waiting[0] = rest
            else:
                self._waiting.popleft()
        return not self._waiting
