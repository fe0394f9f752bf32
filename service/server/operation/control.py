"""Who has control of the robot, and the revision of the state that orders refer to."""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import grpc

from service.trust.rpc import Refusal

LEASE_BYTES = 16


@dataclass(frozen=True)
class Lease:
    """Control of the robot by one operator.

    Attributes:
        token: what orders have to name.
        name: of the client.
        station: what the client calls its place; may be empty.
        since: [s since 1970].
    """

    token: str
    name: str
    station: str
    since: float

    @property
    def holder(self) -> str:
        """Name and station in words."""
        return f"{self.name} ({self.station})" if self.station else self.name


class RobotControl:
    """The lease of a robot, the presence of its holder, and the revision.

    The revision is raised by everything that an operator's next order may depend on. An order names the revision that
    its operator has seen, so that nobody orders about a state that is gone.

    Args:
        on_change: called after every change.
        on_alone: called with the lease whose last Watch call has ended.
        clock: seconds since 1970.
    """

    def __init__(
        self, on_change: Callable[[], None], on_alone: Callable[[Lease], None], clock: Callable[[], float] = time.time
    ) -> None:
        self.revision = 1
        self.lease: Lease | None = None
        self.why = "the server was started"
        self._n_present = 0
        self._on_change = on_change
        self._on_alone = on_alone
        self._clock = clock

    @property
    def is_present(self) -> bool:
        """Whether a Watch call with the lease is open."""
        return self._n_present > 0

    def raise_revision(self, why: str) -> None:
        """Make a new revision, and remember what brought it."""
        self.revision += 1
        self.why = why
        self._on_change()

    def take(self, name: str, station: str, takes_over: bool) -> Lease:
        """Give control to an operator.

        Raises:
            Refusal: somebody else has it, and it is not taken over.
        """
        held = self.lease
        if held is not None and not takes_over:
            since = time.strftime("%H:%M:%S", time.gmtime(held.since))
            raise refuse(f"lease: {held.holder} has control since {since} UTC; take it over explicitly, or wait")
        self.lease = Lease(secrets.token_hex(LEASE_BYTES), name, station, self._clock())
        self._n_present = 0
        self.raise_revision(f"{self.lease.holder} took control{'' if held is None else f' over from {held.holder}'}")
        return self.lease

    def release(self, token: str) -> None:
        """Give control back (Refusal without the lease)."""
        holder = self.require(token).holder
        self.lease, self._n_present = None, 0
        self.raise_revision(f"{holder} released control")

    def require(self, token: str) -> Lease:
        """Return the lease that an order names.

        Raises:
            Refusal: nobody has control, or somebody else has it.
        """
        held = self.lease
        if held is None:
            raise refuse("lease: nobody has control of the robot; take it first")
        if not secrets.compare_digest(held.token.encode(), token.encode()):
            took = "; the one you name has ended" if token else ", and the order names none"
            raise refuse(f"lease: {held.holder} has control{took}")
        return held

    def require_revision(self, expected: int) -> None:
        """Check that an order refers to the present state (Refusal where it does not)."""
        if expected != self.revision:
            raise refuse(
                f"expected_revision: the state is {self.revision}, the order is about {expected}; now {self.why}; "
                "look again"
            )

    @contextmanager
    def attend(self, token: str) -> Iterator[None]:
        """Count an operator as present while the body runs.

        Raises:
            Refusal: the lease is not that of the present holder.
        """
        lease = self.require(token)
        self._n_present += 1
        self._on_change()
        try:
            yield
        finally:
            if self.lease is lease:
                self._n_present -= 1
                self._on_change()
                if self._n_present == 0:
                    self._on_alone(lease)


def refuse(text: str) -> Refusal:
    """Make FAILED_PRECONDITION with a sentence."""
    return Refusal(grpc.StatusCode.FAILED_PRECONDITION, text)
