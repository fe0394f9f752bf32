"""Frames between pool and worker: whole whatever the pieces they come in, refused when they are none."""

from __future__ import annotations

import socket

import pytest

from service.executor.frames import BrokenFrameError, Channel, Frame, Inbox, Kind, Outbox

FRAMES = [Frame(Kind.EVENT, 3, b"abc"), Frame(Kind.READY, 0, b""), Frame(Kind.RETURNED, 2**40, bytes(range(256)) * 5)]


def ends() -> tuple[socket.socket, socket.socket]:
    here, there = socket.socketpair()
    here.setblocking(False)
    return here, there


def as_bytes(frames: list[Frame]) -> bytes:
    here, there = socket.socketpair()
    with here, there:
        for frame in frames:
            Channel(there).send(*frame)
        return here.recv(2**16)


@pytest.mark.parametrize("size", [1, 2, 7, 17, 18, 100, 10_000])
def test_frames_come_whole_in_pieces_of_any_size(size: int) -> None:
    here, there = ends()
    inbox, seen, data = Inbox(here), [], as_bytes(FRAMES)
    with here, there:
        for start in range(0, len(data), size):
            there.sendall(data[start : start + size])
            seen += inbox.read(everything=True)
    assert seen == FRAMES


def test_a_frame_that_breaks_off_is_none() -> None:
    here, there = ends()
    inbox = Inbox(here)
    with here:
        with there:
            there.sendall(as_bytes(FRAMES)[:-1])
        assert list(inbox.read(everything=True)) == FRAMES[:2]
        assert inbox.is_closed


@pytest.mark.parametrize("data", [b"\xff" * 17, b"\x00" * 17, b"\x06" + bytes(8) + b"\xff" * 8])
def test_what_is_no_frame_is_refused(data: bytes) -> None:
    here, there = ends()
    with here, there:
        there.sendall(data)
        with pytest.raises(BrokenFrameError):
            list(Inbox(here).read())


def test_what_the_other_side_does_not_take_is_kept() -> None:
    here, there = ends()
    outbox = Outbox(here)
    payload = bytes(range(256)) * 8000
    with here, there:
        for job in (1, 2):
            outbox.put(Frame(Kind.RUN, job, payload))
        assert not outbox.flush()
        there.setblocking(False)
        inbox, seen = Inbox(there), []
        while not outbox.flush():
            seen += inbox.read(everything=True)
        seen += inbox.read(everything=True)
    assert seen == [Frame(Kind.RUN, 1, payload), Frame(Kind.RUN, 2, payload)]


def test_a_channel_ends_when_the_other_side_does() -> None:
    here, there = socket.socketpair()
    with there:
        with here:
            here.sendall(as_bytes(FRAMES)[:-1])
        channel = Channel(there)
        assert [channel.receive() for _ in range(3)] == [*FRAMES[:2], None]


def test_only_a_few_frames_are_read_at_a_time_unless_all_are_wanted() -> None:
    here, there = ends()
    with here, there:
        there.sendall(as_bytes([Frame(Kind.EVENT, 1, bytes(1000))] * 2) * 70)
        inbox = Inbox(here)
        first = len(list(inbox.read()))
        assert 0 < first < 140
        assert len(list(inbox.read(everything=True))) == 140 - first
