"""How often and how much each client may ask."""

from __future__ import annotations

import ipaddress
import re
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from urllib.parse import unquote

import grpc

from service.trust.rpc import Refusal

_PEER = re.compile(r"ipv[46]:(?P<host>.*):\d+")


class TokenBuckets:
    """One token bucket for each key: ``burst`` at once, ``rate`` a second in the long run.

    An amount above the burst is let in by a full bucket, which then owes it. At most ``max_keys`` buckets are kept; the
    one used least recently goes first.

    Args:
        clock: monotonic [s].
    """

    def __init__(
        self, rate: float, burst: float, *, max_keys: int = 10_000, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._rate = rate
        self._burst = burst
        self._max_keys = max_keys
        self._clock = clock
        self._levels: OrderedDict[str, tuple[float, float]] = OrderedDict()  # level, and when it was so

    def __len__(self) -> int:
        return len(self._levels)

    def take(self, key: str, amount: float = 1.0) -> float:
        """Take an amount out of a bucket, if it is there; returns how long to wait for it, 0 if it was taken [s]."""
        now = self._clock()
        level, then = self._levels.pop(key, (self._burst, now))
        level = min(self._burst, level + self._rate * (now - then))
        needed = min(amount, self._burst)
        is_there = level >= needed
        self._levels[key] = (level - amount if is_there else level, now)
        while len(self._levels) > self._max_keys:
            self._levels.popitem(last=False)
        return 0.0 if is_there else (needed - level) / self._rate


@dataclass(frozen=True)
class ClientLimits:
    """What one client may ask at most.

    Attributes:
        requests_per_s, requests_burst: of any RPC.
        upload_bytes_per_s, upload_bytes_burst: of clouds.
        max_open_calls: being answered at the same time.
    """

    requests_per_s: float = 200.0
    requests_burst: float = 1000.0
    upload_bytes_per_s: float = 16 * 2**20
    upload_bytes_burst: float = 256 * 2**20
    max_open_calls: int = 64


class Limits:
    """The limits of all clients; of one event loop."""

    def __init__(
        self,
        limits: ClientLimits | None = None,
        *,
        max_keys: int = 10_000,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._limits = limits = limits or ClientLimits()
        self._requests = TokenBuckets(limits.requests_per_s, limits.requests_burst, max_keys=max_keys, clock=clock)
        self._bytes = TokenBuckets(limits.upload_bytes_per_s, limits.upload_bytes_burst, max_keys=max_keys, clock=clock)
        self._open: dict[str, int] = {}

    def request(self, key: str) -> Refusal | None:
        """Count a request; why it is refused, if it is."""
        wait = self._requests.take(key)
        words = f"more than {self._limits.requests_per_s:g} requests a second; try again in {wait:.1f} s"
        return _later(words, wait) if wait > 0 else None

    def upload(self, key: str, n_bytes: int, begun: int = 0) -> Refusal | None:
        """Count bytes of an upload; why they are refused, if they are.

        Args:
            begun: bytes that were counted and would have to come again.
        """
        wait = self._bytes.take(key, n_bytes)
        if wait <= 0.0:
            return None
        rate = self._limits.upload_bytes_per_s
        wait += begun / rate
        return _later(f"more than {rate / 2**20:g} MiB uploaded a second; try again in {wait:.1f} s", wait)

    def enter(self, key: str) -> Refusal | None:
        """Begin to answer a call, which then leaves again; why it is refused, if it is."""
        n = self._open.get(key, 0)
        if n >= self._limits.max_open_calls:
            return _later(f"{n} calls of this client are being answered; try again when one has ended", 1.0)
        self._open[key] = n + 1
        return None

    def leave(self, key: str) -> None:
        """A call that entered has ended."""
        n = self._open.pop(key)
        if n > 1:
            self._open[key] = n - 1


def peer_key(peer: str) -> str:
    """What the limits of a peer are counted under: its IPv4 address, or its IPv6 network of 64 bits."""
    match = _PEER.fullmatch(unquote(peer))
    if match is None:
        return peer.partition(":")[0] or "unknown"
    try:
        address = ipaddress.ip_address(match["host"].strip("[]").partition("%")[0])
    except ValueError:
        return "unknown"
    if isinstance(address, ipaddress.IPv6Address):
        mapped = address.ipv4_mapped
        return str(mapped) if mapped else str(ipaddress.ip_network((address, 64), strict=False))
    return str(address)


def _later(words: str, wait_s: float) -> Refusal:
    return Refusal(grpc.StatusCode.RESOURCE_EXHAUSTED, words, wait_s)
