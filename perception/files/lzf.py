"""LZF, the byte compression inside ``binary_compressed`` PCD files.

The stream is a sequence of tokens (format of Marc Lehmann's LibLZF): a control byte below 32 announces that many + 1
literal bytes; otherwise its upper three bits (and, when these are 7, one more byte) hold length - 2 of a copy, and its
lower five bits with the next byte the distance - 1 back into what was written so far.
"""

from __future__ import annotations

_MAX_LITERAL = 32
_MAX_DISTANCE = 1 << 13
_MAX_COPY = 7 + 255 + 2


def decompress(data: bytes, size: int) -> bytes:
    """Unpack ``data`` to exactly ``size`` bytes.

    Raises:
        ValueError: the stream is cut off, points before its beginning or does not hold ``size`` bytes.
    """
    out = bytearray()
    at, end = 0, len(data)
    try:
        while at < end:
            control = data[at]
            at += 1
            if control < _MAX_LITERAL:
                if at + control >= end:
                    raise ValueError("a literal runs past the end")
                out += data[at : at + control + 1]
                at += control + 1
            else:
                length = control >> 5
                if length == 7:
                    length += data[at]
                    at += 1
                start = len(out) - ((control & 0x1F) << 8) - data[at] - 1
                at += 1
                if start < 0:
                    raise ValueError("a copy starts before the beginning")
                _copy(out, start, length + 2)
            if len(out) > size:
                raise ValueError(f"unpacks to more than the announced {size} bytes")
    except IndexError:
        raise ValueError("the stream is cut off") from None
    if len(out) != size:
        raise ValueError(f"unpacks to {len(out)} bytes, announced were {size}")
    return bytes(out)


def _copy(out: bytearray, start: int, length: int) -> None:
    """Append ``length`` bytes from ``start`` on; source and target may overlap, which repeats the pattern."""
    pattern = out[start : start + length]
    if len(pattern) < length:
        repeats = -(-length // len(pattern))
        pattern = (pattern * repeats)[:length]
    out += pattern


def compress(data: bytes) -> bytes:
    """Pack ``data``; greedy matches of three bytes or more at their latest occurrence."""
    out = bytearray()
    latest: dict[bytes, int] = {}
    literal = at = 0
    while at < len(data):
        key = data[at : at + 3]
        before = latest.get(key, -1) if len(key) == 3 else -1
        latest[key] = at
        if before < 0 or at - before > _MAX_DISTANCE:
            at += 1
            continue
        length = _match_length(data, before, at)
        _emit_literals(out, data[literal:at])
        _emit_copy(out, at - before - 1, length - 2)
        at += length
        literal = at
    _emit_literals(out, data[literal:])
    return bytes(out)


def _match_length(data: bytes, before: int, at: int) -> int:
    length, limit = 3, min(_MAX_COPY, len(data) - at)
    while length < limit and data[before + length] == data[at + length]:
        length += 1
    return length


def _emit_literals(out: bytearray, run: bytes) -> None:
    for start in range(0, len(run), _MAX_LITERAL):
        part = run[start : start + _MAX_LITERAL]
        out.append(len(part) - 1)
        out += part


def _emit_copy(out: bytearray, distance: int, length: int) -> None:
    if length < 7:
        out.append(length << 5 | distance >> 8)
    else:
        out += bytes((7 << 5 | distance >> 8, length - 7))
    out.append(distance & 0xFF)
