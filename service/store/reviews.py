"""Reviews of plans: added, never changed, and bound to the hashes of the reviewed plan."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Sequence

from service.errors import shown
from service.store.database import Database
from service.store.errors import NotStoredError, ReviewRefusedError
from service.store.records import Decision, Review, StoreLimits

MAX_COMMENT_CHARACTERS = 4000


class Reviews:
    """The reviews of a store's plans; they are deleted only with their plan."""

    def __init__(self, database: Database, limits: StoreLimits, clock: Callable[[], float]) -> None:
        self._database = database
        self._limits = limits
        self._clock = clock

    def add(
        self,
        plan_id: str,
        decision: Decision,
        reviewer: str,
        plan_sha256: str,
        certificate_sha256: str,
        comment: str = "",
    ) -> Review:
        """Store a review; it survives a power cut as soon as this call has returned.

        Args:
            plan_sha256, certificate_sha256: hashes of the reviewed plan.

        Raises:
            NotStoredError: no plan has this id.
            ReviewRefusedError: the plan has not finished, has other hashes, or has no trajectory or certificate to
                accept; or the review is too long, or one too many.
        """
        if len(comment) > MAX_COMMENT_CHARACTERS:
            raise ReviewRefusedError(
                f"comment: expected at most {MAX_COMMENT_CHARACTERS} characters, got {len(comment)}"
            )
        with self._database.transaction(durable=True) as db:
            plan = db.execute(
                "SELECT state, plan_sha256, certificate_sha256 FROM plans WHERE plan_id = ?", (plan_id,)
            ).fetchone()
            if plan is None:
                raise NotStoredError(
                    f"unknown plan {shown(plan_id)}; it was removed when the store was full, or never was"
                )
            _check(plan, decision, plan_sha256, certificate_sha256)
            rows = db.execute("SELECT decision FROM reviews WHERE plan_id = ? ORDER BY number", (plan_id,)).fetchall()
            if len(rows) >= self._limits.max_reviews and not _withdraws(decision, rows):
                raise ReviewRefusedError(f"the plan has {len(rows)} reviews already, and no more are stored")
            review = Review(plan_id, plan_sha256, certificate_sha256, decision, reviewer, comment, self._clock())
            db.execute(
                "INSERT INTO reviews (plan_id, plan_sha256, certificate_sha256, decision, reviewer, comment, time) "
                "VALUES (?, ?, ?, ?, ?, ?, ?)",
                (plan_id, plan_sha256, certificate_sha256, decision, reviewer, comment, review.time),
            )
            db.execute("UPDATE plans SET is_reviewed = 1 WHERE plan_id = ?", (plan_id,))
        return review

    def find(self, plan_id: str) -> tuple[Review, ...]:
        """Return all reviews of a plan, oldest first; empty for an unknown plan."""
        with self._database.transaction() as db:
            rows = db.execute(
                "SELECT plan_id, plan_sha256, certificate_sha256, decision, reviewer, comment, time FROM reviews "
                "WHERE plan_id = ? ORDER BY number",
                (plan_id,),
            ).fetchall()
        return tuple(Review(**{**dict(row), "decision": Decision(row["decision"])}) for row in rows)

    def is_accepted(self, plan_id: str) -> bool:
        """Return whether the newest review of a plan accepts it."""
        reviews = self.find(plan_id)
        return bool(reviews) and reviews[-1].decision is Decision.ACCEPTED


def _withdraws(decision: Decision, rows: Sequence[sqlite3.Row]) -> bool:
    """Return whether a review withdraws an acceptance, which is stored beyond the limit."""
    return decision is Decision.REJECTED and bool(rows) and rows[-1]["decision"] == Decision.ACCEPTED.value


def _check(plan: sqlite3.Row, decision: Decision, plan_sha256: str, certificate_sha256: str) -> None:
    if plan["state"] != "finished":
        raise ReviewRefusedError(f"the plan is {plan['state']}; only a finished plan can be reviewed")
    hashes = {
        "trajectory": (plan_sha256, plan["plan_sha256"]),
        "certificate": (certificate_sha256, plan["certificate_sha256"]),
    }
    for name, (value, stored) in hashes.items():
        if value != stored:
            raise ReviewRefusedError(
                f"{name}_sha256: expected that of the stored plan, {shown(stored)}, got {shown(value)}; review it again"
            )
    for name, (value, _) in hashes.items():
        if decision is Decision.ACCEPTED and not value:
            raise ReviewRefusedError(f"the plan has no {name} and cannot be accepted")
