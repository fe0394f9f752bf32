"""Times of messages."""

from __future__ import annotations

from google.protobuf.timestamp_pb2 import Timestamp


def encode_time(seconds: float) -> Timestamp:
    """Return the message of a time [s since 1970]."""
    stamp = Timestamp()
    stamp.FromNanoseconds(int(seconds * 1e9))
    return stamp


def decode_time(stamp: Timestamp) -> float:
    """Return the time of a message [s since 1970]; 0 for an empty one.

    Raises:
        ValueError: it is out of range.
    """
    try:
        stamp.ToDatetime()
    except (ValueError, OverflowError):
        raise ValueError(f"{stamp.seconds} s and {stamp.nanos} ns since 1970 are out of range") from None
    return stamp.seconds + stamp.nanos * 1e-9
