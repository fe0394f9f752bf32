"""Limits of each client's requests, uploads and open calls."""

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
    """One token bucket per key: ``burst`` at once, ``rate`` per second in the long run.

    A full bucket allows an amount above the burst, and its level becomes negative. At most ``max_keys`` buckets are
    kept; the least recently used one is dropped first.

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
        self._levels: OrderedDict[str, tuple[float, float]] = OrderedDict()  # level and its time

    def __len__(self) -> int:
        return len(self._levels)

    def take(self, key: str, amount: float = 1.0) -> float:
        """Take an amount out of a bucket if it holds enough; returns how long to wait otherwise [s]."""
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
    """Limits of one client.

    Attributes:
        requests_per_s, requests_burst: requests of any RPC.
        upload_bytes_per_s, upload_bytes_burst: bytes of uploads.
        max_open_calls: open calls at a time.
    """

    requests_per_s: float = 200.0
    requests_burst: float = 1000.0
    upload_bytes_per_s: float = 16 * 2**20
    upload_bytes_burst: float = 256 * 2**20
    max_open_calls: int = 64


class ClientLimiter:
    """Counts of all clients against their limits; for use in one event loop."""

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
        """Count a request; returns the refusal if it exceeds the limit."""
        wait = self._requests.take(key)
        text = f"more than {self._limits.requests_per_s:g} requests a second; try again in {wait:.1f} s"
        return _refuse_for(wait, text) if wait > 0 else None

    def upload(self, key: str, n_bytes: int, already_counted: int = 0) -> Refusal | None:
        """Count bytes of an upload; returns the refusal if they exceed the limit.

        Args:
            already_counted: bytes of the same upload, which have to be sent again after a refusal.
        """
        wait = self._bytes.take(key, n_bytes)
        if wait <= 0.0:
            return None
        rate = self._limits.upload_bytes_per_s
        wait += already_counted / rate
        return _refuse_for(wait, f"more than {rate / 2**20:g} MiB uploaded a second; try again in {wait:.1f} s")

    def enter(self, key: str) -> Refusal | None:
        """Count an open call until ``leave``; returns the refusal if it exceeds the limit."""
        n = self._open.get(key, 0)
        if n >= self._limits.max_open_calls:
            return _refuse_for(1.0, f"{n} calls of this client are open; try again when one has ended")
        self._open[key] = n + 1
        return None

    def leave(self, key: str) -> None:
        """Count the end of an open call."""
        n = self._open.pop(key)
        if n > 1:
            self._open[key] = n - 1


def peer_key(peer: str) -> str:
    """Return the key of a peer's limits: its IPv4 address, or its IPv6 network of 64 bits."""
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


def _refuse_for(wait_s: float, text: str) -> Refusal:
    return Refusal(grpc.StatusCode.RESOURCE_EXHAUSTED, text, wait_s)
