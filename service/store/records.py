"""What the store hands out: plans, reviews, and how full it is."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class PlanState(StrEnum):
    """How far a plan has come."""

    ACCEPTED = "accepted"
    RUNNING = "running"
    FINISHED = "finished"
    LOST = "lost"  # it never finished; its request may run again


class Outcome(StrEnum):
    """What the store knows of a request that begins."""

    NEW = "new"  # to be run
    RUNNING = "running"  # the same request is being run
    FINISHED = "finished"  # its reply is there
    CONFLICT = "conflict"  # the same request_id stands for another request


class Decision(StrEnum):
    """What a reviewer says of a plan."""

    ACCEPTED = "ACCEPTED"
    REJECTED = "REJECTED"


@dataclass(frozen=True)
class PlanRecord:
    """A plan as it is stored.

    Attributes:
        plan_id: of the store's making.
        client: who asked; request_id: how the client calls it, empty if it does not.
        request_sha256: of the request's canonical form.
        kind: of request.
        why_lost: of a lost plan.
        verdict: of a finished plan; reply: what the client got, serialized.
        plan_sha256, certificate_sha256: what reviews are bound to; empty where there is none.
        archive_bytes: size of its archive, 0 without one.
        created, finished: [s since 1970].
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
    archive_bytes: int
    created: float
    finished: float | None


@dataclass(frozen=True)
class Begun:
    """What became of a request that begins, and the plan that stands for it."""

    outcome: Outcome
    plan: PlanRecord


@dataclass(frozen=True)
class Review:
    """What a person said of a plan, bound to the plan and the certificate that were looked at.

    Attributes:
        time: [s since 1970].
    """

    plan_id: str
    plan_sha256: str
    certificate_sha256: str
    decision: Decision
    reviewer: str
    comment: str
    time: float


@dataclass(frozen=True)
class StoreLimits:
    """How much is kept at most.

    Attributes:
        max_plans, max_bytes: of plans, their replies and archives; the oldest go first, reviewed ones last.
        max_scenes, max_scene_bytes: of scenes (compressed); those not used for longest go first.
        max_reviews: of one plan.
    """

    max_plans: int = 10_000
    max_bytes: int = 2 * 2**30
    max_scenes: int = 1000
    max_scene_bytes: int = 512 * 2**20
    max_reviews: int = 100


@dataclass(frozen=True)
class StoreStats:
    """How full the store is [bytes: of replies, archives and scenes]."""

    n_plans: int
    plan_bytes: int
    n_scenes: int
    scene_bytes: int
