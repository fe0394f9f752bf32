"""Records of the store: plans, reviews, limits and statistics."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class PlanState(StrEnum):
    """State of a stored plan."""

    ACCEPTED = "accepted"
    FINISHED = "finished"
    LOST = "lost"  # it ended without a reply; its request may run again


class Decision(StrEnum):
    """Decision of a review."""

    ACCEPTED = "ACCEPTED"
    REJECTED = "REJECTED"


@dataclass(frozen=True)
class PlanRecord:
    """A plan as it is stored.

    Attributes:
        plan_id: id made by the store.
        client: name of the client.
        request_id: the client's own id, may be empty.
        request_sha256: hash of the request's canonical form.
        kind: kind of request.
        why_lost: reason of a lost plan.
        verdict: verdict of a finished plan.
        reply: serialized result of a finished plan.
        plan_sha256, certificate_sha256: hashes that reviews refer to; empty without trajectory or certificate.
        page_sha256: hash of the viewer's page in the archive, which reviews refer to as well; empty without one.
        archive_sha256: hash of its archive; empty without one.
        archive_bytes: size of its archive, 0 without one.
        created, finished: [s since 1970].
        request: content that begins an open plan again after a restart; empty for others.
        deadline: after which an open plan is not begun again [s since 1970]; None for never.
        n_resumed: restarts after which it was begun again.
        reviews_seal: seal of its newest review; empty without one.
    """

    plan_id: str
    client: str
    request_id: str
    request_sha256: str
    kind: str
    state: PlanState
    why_lost: str
    verdict: str
    reply: bytes
    plan_sha256: str
    certificate_sha256: str
    page_sha256: str
    archive_sha256: str
    archive_bytes: int
    created: float
    finished: float | None
    request: bytes
    deadline: float | None
    n_resumed: int
    reviews_seal: str


@dataclass(frozen=True)
class Review:
    """A person's review, bound to the hashes of the trajectory, the certificate and the page that were reviewed.

    Attributes:
        time: [s since 1970].
        page_sha256: empty for a plan without files.
        approval: signed statement of an acceptance, or of its withdrawal; empty without one.
        verdict: of the reviewed plan; empty where an earlier version stored the review.
        expires: end of an acceptance's validity [s since 1970]; 0 for other reviews and those of earlier versions.
    """

    plan_id: str
    plan_sha256: str
    certificate_sha256: str
    decision: Decision
    reviewer: str
    comment: str
    time: float
    page_sha256: str = ""
    approval: bytes = b""
    verdict: str = ""
    expires: float = 0.0


@dataclass(frozen=True)
class StoreLimits:
    """Limits of the store.

    Attributes:
        max_plans, max_bytes: plans, and their replies and archives; the oldest are deleted first, reviewed ones last.
        max_scenes, max_scene_bytes: scenes (compressed); the least recently used are deleted first.
        max_reviews: reviews of one plan.
    """

    max_plans: int = 10_000
    max_bytes: int = 2 * 2**30
    max_scenes: int = 1000
    max_scene_bytes: int = 512 * 2**20
    max_reviews: int = 100


@dataclass(frozen=True)
class StoreStats:
    """Number and size of the stored plans and scenes."""

    n_plans: int
    plan_bytes: int
    n_scenes: int
    scene_bytes: int
