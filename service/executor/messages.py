"""Messages on the socket between pool and worker: a kind, a job's number and a payload, framed by a header."""

from __future__ import annotations

import enum
import socket
import struct
from collections import deque
from collections.abc import Iterator
from typing import NamedTuple

MAX_PAYLOAD_BYTES = 2**30
_HEADER = struct.Struct("<BQQ")  # kind, job, length of the payload
_CHUNK = 2**16
_MAX_SENT = 2**20  # at a time


class Kind(enum.IntEnum):
    """Kind of a message."""

    SETUP = 1  # to the worker: what it needs to become ready
    RUN = 2  # to the worker: a pickled call
    STARTED = 3  # from the worker: its process id
    READY = 4
    START_FAILED = 5  # the traceback
    EVENT = 6  # reported by a job
    RETURNED = 7
    RAISED = 8


class Message(NamedTuple):
    """One message; ``job`` is 0 for messages that concern no job."""

    kind: Kind
    job: int
    payload: bytes


class MalformedMessageError(Exception):
    """Received bytes are not a message."""


class BlockingChannel:
    """The worker's end of the socket: each call waits until the whole message is through."""

    def __init__(self, sock: socket.socket) -> None:
        self._sock = sock

    def send(self, kind: Kind, job: int, payload: bytes) -> None:
        """Send a message."""
        header = _HEADER.pack(kind, job, len(payload))
        if len(payload) < _CHUNK:
            self._sock.sendall(header + payload)  # in one call, since each call wakes the other side
        else:
            self._sock.sendall(header)
            self._sock.sendall(payload)

    def receive(self) -> Message | None:
        """Return the next message, None when the other side has closed."""
        header = self._receive_bytes(_HEADER.size)
        if header is None:
            return None
        kind, job, length = _HEADER.unpack(header)
        payload = self._receive_bytes(length)
        return None if payload is None else Message(Kind(kind), job, bytes(payload))

    def _receive_bytes(self, n: int) -> bytearray | None:
        buffer = bytearray(n)
        view, filled = memoryview(buffer), 0
        while filled < n:
            n_received = self._sock.recv_into(view[filled:])
            if n_received == 0:
                return None
            filled += n_received
        return buffer


class MessageReader:
    """The pool's reading end: takes the bytes that have arrived and never waits for more."""

    def __init__(self, sock: socket.socket) -> None:
        self._sock = sock
        self._buffer = bytearray()
        self.is_closed = False

    def read(self, everything: bool = False) -> Iterator[Message]:
        """Yield the messages that are complete; ``is_closed`` is set once no more can follow.

        Args:
            everything: read until nothing is left, not only until the first messages are complete.

        Raises:
            MalformedMessageError: the bytes are not a message.
        """
        n_messages = 0
        while not self.is_closed and (everything or n_messages == 0):
            try:
                data = self._sock.recv(_CHUNK)
            except BlockingIOError:
                break
            except OSError:
                data = b""
            self.is_closed = not data
            self._buffer += data
            for message in self._split_buffer():
                n_messages += 1
                yield message

    def _split_buffer(self) -> Iterator[Message]:
        while len(self._buffer) >= _HEADER.size:
            kind, job, length = _HEADER.unpack_from(self._buffer)
            if kind not in set(Kind) or length > MAX_PAYLOAD_BYTES:
                raise MalformedMessageError(f"kind {kind}, {length} bytes")
            end = _HEADER.size + length
            if len(self._buffer) < end:
                return
            payload = bytes(memoryview(self._buffer)[_HEADER.size : end])
            del self._buffer[:end]
            yield Message(Kind(kind), job, payload)


class MessageWriter:
    """The pool's writing end: sends what the socket takes and keeps the rest."""

    def __init__(self, sock: socket.socket) -> None:
        self._sock = sock
        self._unsent: deque[memoryview] = deque()

    def put(self, message: Message) -> None:
        """Queue a message behind those not sent yet."""
        header = _HEADER.pack(message.kind, message.job, len(message.payload))
        if len(message.payload) < _CHUNK:
            self._unsent.append(memoryview(header + message.payload))
        else:
            self._unsent += [memoryview(header), memoryview(message.payload)]

    def flush(self) -> bool:
        """Send some of what can be sent without waiting; return whether nothing is left."""
        n_bytes = 0
        while self._unsent and n_bytes < _MAX_SENT:
            try:
                n_sent = self._sock.send(self._unsent[0])
            except BlockingIOError:
                return False
            except OSError:  # the worker is gone, which the reading end notices
                self._unsent.clear()
                return True
            n_bytes += n_sent
            rest = self._unsent[0][n_sent:]
            if rest:
                self._unsent[0] = rest
            else:
                self._unsent.popleft()
        return not self._unsent
