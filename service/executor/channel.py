"""Between the pool and its processes: messages on a socket (kind, number of the job, payload), and output on a pipe."""

from __future__ import annotations

import asyncio
import enum
import os
import select
import socket
import struct
import threading
from collections import deque
from collections.abc import Callable, Container, Iterator
from contextlib import suppress
from typing import NamedTuple

from service.executor.job import LOG

MAX_PAYLOAD_BYTES = 2**30
_HEADER = struct.Struct("<BQQ")  # kind, job, length of the payload
_CHUNK = 2**16
_MAX_SENT = _MAX_RECEIVED = 2**20  # at a time
_MAX_LINE = 2000
_READ_AGAIN_S = 0.002  # after the pool's thread was busy
_MAX_TAIL = 4000  # a crash of a worker prints some 30 lines of stack after its own last words


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


_KINDS = frozenset(Kind)


class Message(NamedTuple):
    """One message; ``job`` is 0 for messages that concern no job."""

    kind: Kind
    job: int
    payload: bytes


class MalformedMessageError(Exception):
    """Received bytes are not a message."""


def _encode(kind: Kind, job: int, payload: bytes) -> list[bytes]:
    header = _HEADER.pack(kind, job, len(payload))
    return [header + payload] if len(payload) < _CHUNK else [header, payload]  # each part wakes the other side


class MessageReader:
    """The reading end: takes the bytes that have arrived; the pool's socket never waits for more."""

    def __init__(self, sock: socket.socket) -> None:
        self._sock = sock
        self._buffer = bytearray()
        self.is_closed = False

    def read(self, everything: bool = False) -> Iterator[Message]:
        """Yield the messages that are complete; ``is_closed`` is set once no more can follow.

        Args:
            everything: read until nothing is left, not only until the first messages are complete or ``_MAX_RECEIVED``
                bytes have been read, after which it is somebody else's turn.

        Raises:
            MalformedMessageError: the bytes are not a message.
        """
        n_messages = n_bytes = 0
        while not self.is_closed and (everything or (n_messages == 0 and n_bytes < _MAX_RECEIVED)):
            try:
                data = self._sock.recv(_CHUNK)
            except BlockingIOError:
                break
            except OSError:
                data = b""
            self.is_closed = not data
            self._buffer += data
            n_bytes += len(data)
            for message in self._split_buffer():
                n_messages += 1
                yield message

    def _split_buffer(self) -> Iterator[Message]:
        while len(self._buffer) >= _HEADER.size:
            kind, job, length = _HEADER.unpack_from(self._buffer)
            if kind not in _KINDS or length > MAX_PAYLOAD_BYTES:
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
        self._unsent += map(memoryview, _encode(*message))

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


class Inbox:
    """The pool's sockets, read by its own event loop or by one of the caller to which it is lent.

    The reader waits for one descriptor, an epoll of all sockets, which any thread may add and remove.

    Args:
        loop: the pool's event loop.
        guard: lock that the pool's thread holds except while it waits for events.
        read: called with the descriptors of the sockets that have something, by a thread that holds the guard.
    """

    def __init__(
        self, loop: asyncio.AbstractEventLoop, guard: threading.Lock, read: Callable[[Container[int]], None]
    ) -> None:
        self._loop = loop
        self._guard = guard
        self._read = read
        self._epoll = select.epoll()
        self._borrower: asyncio.AbstractEventLoop | None = None
        loop.add_reader(self._epoll, self._read_ready)

    def add(self, sock: socket.socket) -> None:
        """Read a socket from now on."""
        self._epoll.register(sock, select.EPOLLIN)

    def remove(self, sock: socket.socket) -> None:
        """Read a socket no longer, if it was read."""
        with suppress(FileNotFoundError):
            self._epoll.unregister(sock)

    def lend(self, borrower: asyncio.AbstractEventLoop) -> None:
        """Have a running event loop read, until ``take_back``; both are called in its thread."""
        with self._guard:
            self._borrower = borrower
            self._loop.remove_reader(self._epoll)
        borrower.add_reader(self._epoll, self._read_borrowed)

    def take_back(self) -> None:
        """Have the pool's own event loop read again."""
        with self._guard:
            borrower, self._borrower = self._borrower, None
            if borrower is not None:
                borrower.remove_reader(self._epoll)
            if self._loop.is_closed():
                self._epoll.close()
            else:
                self._loop.add_reader(self._epoll, self._read_ready)

    def close(self) -> None:
        """Close the epoll; a borrower closes it when it gives it back."""
        if self._borrower is None:
            self._loop.remove_reader(self._epoll)
            self._epoll.close()

    def _read_ready(self) -> None:
        self._read({fd for fd, _ in self._epoll.poll(0)})

    def _read_borrowed(self) -> None:
        if self._guard.acquire(blocking=False):
            try:
                self._read_ready()
            finally:
                self._guard.release()
        elif self._borrower is not None:  # the pool's thread is busy, for which nobody should wait
            self._borrower.remove_reader(self._epoll)
            self._borrower.call_later(_READ_AGAIN_S, self._read_again)

    def _read_again(self) -> None:
        if self._borrower is not None:
            self._borrower.add_reader(self._epoll, self._read_borrowed)


class BlockingChannel:
    """The worker's end of the socket: each call waits until the whole message is through."""

    def __init__(self, sock: socket.socket) -> None:
        self._sock = sock
        self._received = self._receive_all()

    def send(self, kind: Kind, job: int, payload: bytes) -> None:
        """Send a message."""
        for part in _encode(kind, job, payload):
            self._sock.sendall(part)

    def receive(self) -> Message | None:
        """Return the next message, None when the other side has closed."""
        return next(self._received, None)

    def _receive_all(self) -> Iterator[Message]:
        reader = MessageReader(self._sock)
        while not reader.is_closed:
            yield from reader.read()


class ProcessOutput:
    """A pipe for a process's standard output and error: logged line by line, its end kept.

    Attributes:
        name: of the process in the log.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._line = b""
        self._tail = b""
        self.fd, self.write_fd = os.pipe()
        os.set_blocking(self.fd, False)

    @property
    def tail(self) -> str:
        """The end of the output."""
        return self._tail.decode(errors="replace").strip()

    def read(self) -> bool:
        """Log what has arrived; return False when no more can follow."""
        try:
            data = os.read(self.fd, _CHUNK)
        except BlockingIOError:
            return True
        self._tail = (self._tail + data)[-_MAX_TAIL:]
        *lines, self._line = (self._line + data).split(b"\n")
        if len(self._line) > _MAX_LINE or not data:
            lines, self._line = [*lines, self._line], b""
        for line in lines:
            if line.strip():
                LOG.info("%s: %s", self.name, line[:_MAX_LINE].decode(errors="replace").rstrip())
        return bool(data)

    def close_write_end(self) -> None:
        """Close the writing end once the process has its copy."""
        if self.write_fd >= 0:
            os.close(self.write_fd)
            self.write_fd = -1

    def close(self) -> None:
        """Log the rest and close the pipe."""
        self.close_write_end()
        self.read()
        os.close(self.fd)
