"""Reviews of plans: added, never changed, and bound to the hashes of the reviewed plan."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, fields, replace

from service.errors import shown
from service.store.database import Database, insert_review, seal_plan
from service.store.errors import DamagedError, ReviewRefusedError
from service.store.plans import Plans
from service.store.records import Decision, PlanRecord, PlanState, Review, StoreLimits
from service.store.seals import SEAL, compute_seal

MAX_COMMENT_CHARACTERS = 4000
CERTIFIED = "CERTIFIED"
DAY_S = 86400.0
VALID_S = 30 * DAY_S  # of an acceptance, unless the reviewer says otherwise
MAX_VALID_S = 366 * DAY_S


class Reviews:
    """The reviews of a store's plans; they are deleted only with their plan."""

    def __init__(self, database: Database, plans: Plans, limits: StoreLimits, clock: Callable[[], float]) -> None:
        self._database = database
        self._plans = plans
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
        page_sha256: str = "",
        sign: Callable[[PlanRecord, Review], bytes] | None = None,
        *,
        verdict: str = CERTIFIED,
        despite: str = "",
        valid_s: float = VALID_S,
    ) -> Review:
        """Store a review; it survives a power cut as soon as this call has returned.

        Args:
            plan_sha256, certificate_sha256, page_sha256: hashes of the reviewed plan.
            sign: makes the signed statement of an acceptance, or of its withdrawal, from the plan and its review.
            verdict: that the reviewer has seen.
            despite: the verdict once more, to accept a plan without ``CERTIFIED``; else empty.
            valid_s: validity of an acceptance [s].

        Raises:
            NotStoredError: no plan has this id.
            DamagedError: the plan, its files or its reviews are not what was stored.
            ReviewRefusedError: the plan has not finished, has other hashes or another verdict, or has no trajectory or
                certificate to accept; or the review is too long, or one too many.
        """
        if len(comment) > MAX_COMMENT_CHARACTERS:
            raise ReviewRefusedError(
                f"comment: expected at most {MAX_COMMENT_CHARACTERS} characters, got {len(comment)}"
            )
        plan = self._plans.get(plan_id)
        earlier = self.find(plan_id)
        is_withdrawal = _withdraws(decision, earlier)
        if not is_withdrawal:  # an approval can be taken back whatever has become of the files
            self._plans.check_archive(plan)  # before the transaction, since a large one takes a while
        _check(plan, decision, plan_sha256, certificate_sha256, page_sha256)
        is_acceptance = decision is Decision.ACCEPTED
        if is_acceptance:
            _check_verdict(plan.verdict, verdict, despite)
            _check_validity(valid_s)
        if len(earlier) >= self._limits.max_reviews and not is_withdrawal:
            raise ReviewRefusedError(f"the plan has {len(earlier)} reviews already, and no more are stored")
        now = self._clock()
        review = Review(
            plan_id,
            plan_sha256,
            certificate_sha256,
            decision,
            reviewer,
            comment,
            now,
            page_sha256,
            verdict=plan.verdict,
            expires=now + valid_s if is_acceptance else 0.0,
        )
        if sign is not None and (is_acceptance or is_withdrawal):
            review = replace(review, approval=sign(plan, review))
        with self._database.transaction(durable=True) as db:
            self._plans.require_same(db, plan)
            insert_review(db, {**asdict(review), "decision": decision.value})
            seal_plan(db, plan_id)
        return review

    def find(self, plan_id: str) -> tuple[Review, ...]:
        """Return all reviews of a plan, oldest first; empty for an unknown plan.

        Raises:
            DamagedError: they are not what was stored.
        """
        with self._database.reading() as db:
            plan = db.execute("SELECT reviews_seal FROM plans WHERE plan_id = ?", (plan_id,)).fetchone()
            rows = db.execute("SELECT * FROM reviews WHERE plan_id = ? ORDER BY number", (plan_id,)).fetchall()
        seal = ""
        for row in rows:
            seal = compute_seal(dict(row), seal)
            if seal != row[SEAL]:
                raise _damage(plan_id)
        if plan is not None and seal != plan["reviews_seal"]:
            raise _damage(plan_id)
        names = [field.name for field in fields(Review)]
        return tuple(
            Review(**{**{name: row[name] for name in names}, "decision": Decision(row["decision"])}) for row in rows
        )

    def is_accepted(self, plan_id: str) -> bool:
        """Return whether the newest review of a plan accepts it, and is still valid."""
        return self.is_valid(self.find(plan_id))

    def is_valid(self, reviews: Sequence[Review]) -> bool:
        """Return whether the last of a plan's reviews accepts it, and is still valid."""
        return bool(reviews) and reviews[-1].decision is Decision.ACCEPTED and self._clock() < reviews[-1].expires


def _withdraws(decision: Decision, earlier: Sequence[Review]) -> bool:
    """Return whether a review withdraws an acceptance, which is stored beyond the limit."""
    return decision is Decision.REJECTED and bool(earlier) and earlier[-1].decision is Decision.ACCEPTED


def _damage(plan_id: str) -> DamagedError:
    return DamagedError(f"plan {plan_id}: its reviews are damaged on this server's disk; plan it again and review that")


def _check_verdict(stored: str, seen: str, despite: str) -> None:
    """Check that the reviewer has seen the plan's verdict, and says so where it is not ``CERTIFIED``."""
    if seen != stored:
        raise ReviewRefusedError(f"verdict: expected that of the stored plan, {stored}, got {seen}; review it again")
    if stored == CERTIFIED and despite:
        raise ReviewRefusedError(f"despite: the plan is {CERTIFIED}; leave out {despite}")
    if stored != CERTIFIED and despite != stored:
        raise ReviewRefusedError(
            f"despite: the plan is {stored}, not {CERTIFIED}; expected {stored} "
            f"(scopt review --accept --despite {stored}), got {despite or 'none'}"
        )


def _check_validity(valid_s: float) -> None:
    if not 0.0 < valid_s <= MAX_VALID_S:
        raise ReviewRefusedError(
            f"valid_s: {valid_s:g} s; expected more than 0 and at most {MAX_VALID_S:g} s ({MAX_VALID_S / DAY_S:g} days)"
        )


def _check(plan: PlanRecord, decision: Decision, plan_sha256: str, certificate_sha256: str, page_sha256: str) -> None:
    if plan.state is not PlanState.FINISHED:
        raise ReviewRefusedError(f"the plan is {plan.state}; only a finished plan can be reviewed")
    hashes = {
        "trajectory": (plan_sha256, plan.plan_sha256),
        "certificate": (certificate_sha256, plan.certificate_sha256),
    }
    if decision is Decision.ACCEPTED or page_sha256:  # an approval covers the page; a rejection needs no look at it
        hashes["page"] = (page_sha256, plan.page_sha256)
    for name, (value, stored) in hashes.items():
        if value != stored:
            raise ReviewRefusedError(
                f"{name}_sha256: expected that of the stored plan, {shown(stored)}, got {shown(value)}; review it again"
            )
    for name in ("trajectory", "certificate"):
        if decision is Decision.ACCEPTED and not hashes[name][0]:
            raise ReviewRefusedError(f"the plan has no {name} and cannot be accepted")
