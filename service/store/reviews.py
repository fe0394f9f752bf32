"""What people said of plans: added, never changed, and bound to what they looked at."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Sequence

from service.errors import shown
from service.store.database import Database
from service.store.errors import NotStoredError, ReviewRefusedError
from service.store.records import Decision, Review, StoreLimits

MAX_COMMENT_CHARACTERS = 4000


class Reviews:
    """The reviews of a store's plans; they go only with their plan."""

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
        """Keep a review; from the return of this call on it survives a power cut.

        Args:
            plan_sha256, certificate_sha256: of what the reviewer looked at.

        Raises:
            NotStoredError: there is no plan of that id.
            ReviewRefusedError: the plan has not finished, is another than the reviewer looked at, has nothing that
                could be accepted, or the review is too long or one too many.
        """
        if len(comment) > MAX_COMMENT_CHARACTERS:
            raise ReviewRefusedError(
                f"comment has {len(comment)} characters; at most {MAX_COMMENT_CHARACTERS} would do"
            )
        with self._database.transaction(durable=True) as db:
            plan = db.execute(
                "SELECT state, plan_sha256, certificate_sha256 FROM plans WHERE plan_id = ?", (plan_id,)
            ).fetchone()
            if plan is None:
                raise NotStoredError(f"no plan {shown(plan_id)}; it never was, or went when the store was full")
            _check(plan, decision, plan_sha256, certificate_sha256)
            said = db.execute("SELECT decision FROM reviews WHERE plan_id = ? ORDER BY number", (plan_id,)).fetchall()
            if len(said) >= self._limits.max_reviews and not _withdraws(decision, said):
                raise ReviewRefusedError(f"the plan has {len(said)} reviews already, and no more are kept")
            review = Review(plan_id, plan_sha256, certificate_sha256, decision, reviewer, comment, self._clock())
            db.execute(
                "INSERT INTO reviews (plan_id, plan_sha256, certificate_sha256, decision, reviewer, comment, time) "
                "VALUES (?, ?, ?, ?, ?, ?, ?)",
                (plan_id, plan_sha256, certificate_sha256, decision, reviewer, comment, review.time),
            )
            db.execute("UPDATE plans SET is_reviewed = 1 WHERE plan_id = ?", (plan_id,))
        return review

    def of(self, plan_id: str) -> tuple[Review, ...]:
        """All reviews of a plan, the first one first; none of a plan that is not there."""
        with self._database.transaction() as db:
            rows = db.execute(
                "SELECT plan_id, plan_sha256, certificate_sha256, decision, reviewer, comment, time FROM reviews "
                "WHERE plan_id = ? ORDER BY number",
                (plan_id,),
            ).fetchall()
        return tuple(Review(**{**dict(row), "decision": Decision(row["decision"])}) for row in rows)

    def is_accepted(self, plan_id: str) -> bool:
        """Whether a person stands behind a plan: the last word on it is that it is accepted."""
        reviews = self.of(plan_id)
        return bool(reviews) and reviews[-1].decision is Decision.ACCEPTED


def _withdraws(decision: Decision, said: Sequence[sqlite3.Row]) -> bool:
    """Whether a review takes back an approval: there is always room for that."""
    return decision is Decision.REJECTED and bool(said) and said[-1]["decision"] == Decision.ACCEPTED.value


def _check(plan: sqlite3.Row, decision: Decision, plan_sha256: str, certificate_sha256: str) -> None:
    if plan["state"] != "finished":
        raise ReviewRefusedError(f"the plan is {plan['state']}; only a finished one can be reviewed")
    asked = {
        "trajectory": (plan_sha256, plan["plan_sha256"]),
        "certificate": (certificate_sha256, plan["certificate_sha256"]),
    }
    for name, (value, stored) in asked.items():
        if value != stored:
            raise ReviewRefusedError(
                f"{name}_sha256 {shown(value)} is not that of the stored plan, {shown(stored)}; look at it anew"
            )
    for name, (value, _) in asked.items():
        if decision is Decision.ACCEPTED and not value:
            raise ReviewRefusedError(f"the plan has no {name}: nothing that could be accepted")
