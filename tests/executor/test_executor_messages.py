"""Messages between pool and worker: delivered whole in pieces of any size, refused when malformed."""

from __future__ import annotations

import socket
import struct

import pytest

from service.executor.channel import (
    BlockingChannel,
    Kind,
    MalformedMessageError,
    Message,
    MessageReader,
    MessageWriter,
)

MESSAGES = [
    Message(Kind.EVENT, 3, b"abc"),
    Message(Kind.READY, 0, b""),
    Message(Kind.RETURNED, 2**40, bytes(range(256)) * 5),
]


def ends() -> tuple[socket.socket, socket.socket]:
    here, there = socket.socketpair()
    here.setblocking(False)
    return here, there


def as_bytes(messages: list[Message]) -> bytes:
    here, there = socket.socketpair()
    with here, there:
        for message in messages:
            BlockingChannel(there).send(*message)
        return here.recv(2**16)


@pytest.mark.parametrize("size", [1, 2, 7, 17, 18, 100, 10_000])
def test_messages_arrive_whole_in_pieces_of_any_size(size: int) -> None:
    here, there = ends()
    reader, seen, data = MessageReader(here), [], as_bytes(MESSAGES)
    with here, there:
        for start in range(0, len(data), size):
            there.sendall(data[start : start + size])
            seen += reader.read(everything=True)
    assert seen == MESSAGES


def test_an_incomplete_message_is_not_delivered() -> None:
    here, there = ends()
    reader = MessageReader(here)
    with here:
        with there:
            there.sendall(as_bytes(MESSAGES)[:-1])
        assert list(reader.read(everything=True)) == MESSAGES[:2]
        assert reader.is_closed


@pytest.mark.parametrize("data", [b"\xff" * 17, b"\x00" * 17, b"\x06" + bytes(8) + b"\xff" * 8])
def test_bytes_that_are_not_a_message_are_refused(data: bytes) -> None:
    here, there = ends()
    with here, there:
        there.sendall(data)
        with pytest.raises(MalformedMessageError):
            list(MessageReader(here).read())


def test_bytes_that_the_other_side_does_not_take_are_kept() -> None:
    here, there = ends()
    writer = MessageWriter(here)
    payload = bytes(range(256)) * 8000
    with here, there:
        for job in (1, 2):
            writer.put(Message(Kind.RUN, job, payload))
        assert not writer.flush()
        there.setblocking(False)
        reader, seen = MessageReader(there), []
        while not writer.flush():
            seen += reader.read(everything=True)
        seen += reader.read(everything=True)
    assert seen == [Message(Kind.RUN, 1, payload), Message(Kind.RUN, 2, payload)]


def test_a_channel_ends_when_the_other_side_does() -> None:
    here, there = socket.socketpair()
    with there:
        with here:
            here.sendall(as_bytes(MESSAGES)[:-1])
        channel = BlockingChannel(there)
        assert [channel.receive() for _ in range(3)] == [*MESSAGES[:2], None]


def test_only_a_few_messages_are_read_at_a_time_unless_all_are_requested() -> None:
    here, there = ends()
    with here, there:
        there.sendall(as_bytes([Message(Kind.EVENT, 1, bytes(1000))] * 2) * 70)
        reader = MessageReader(here)
        first = len(list(reader.read()))
        assert 0 < first < 140
        assert len(list(reader.read(everything=True))) == 140 - first


def test_a_message_that_does_not_end_does_not_keep_the_reader() -> None:
    class Fast:
        """A sender of one large message that is always ahead of the reader."""

        n_bytes = 0

        def recv(self, size: int) -> bytes:
            start = struct.pack("<BQQ", Kind.RETURNED, 1, 2**29) if self.n_bytes == 0 else b""
            self.n_bytes += size
            return start.ljust(size, b"x")

    sock = Fast()
    reader = MessageReader(sock)  # type: ignore[arg-type]
    assert list(reader.read()) == []
    assert sock.n_bytes == 2**20
    assert not reader.is_closed
