"""Lists of stored plans and scenes, newest first, page by page."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from service.store.database import Database
from service.store.errors import DamagedError
from service.store.plans import Plans
from service.store.records import PlanRecord, PlanState, Review
from service.store.reviews import Reviews

DIRECT = "direct"  # kind of direct moves, which wait for no decision and are listed only by this kind
# A plan that somebody has to decide on: it can be accepted, and nobody has decided, or the acceptance has expired.
_NEEDS_REVIEW = (
    "(state = 'finished' AND kind != :direct AND plan_sha256 != '' AND certificate_sha256 != '' AND ifnull((SELECT "
    "decision = 'ACCEPTED' AND expires <= :now FROM reviews WHERE reviews.plan_id = plans.plan_id ORDER BY number DESC "
    "LIMIT 1), 1))"
)


@dataclass(frozen=True)
class PlanFilter:
    """Which plans a list has.

    Attributes:
        client: name of the client whose plans they are; empty for all.
        states: their states; empty for all.
        since: when their requests were accepted, at the earliest [s since 1970].
        kind: kind of request; empty for all but direct moves.
        needs_review: only those that wait for a decision.
    """

    client: str = ""
    states: tuple[PlanState, ...] = ()
    since: float = 0.0
    kind: str = ""
    needs_review: bool = False


@dataclass(frozen=True)
class ListedPlan:
    """A plan of a list.

    Attributes:
        number: its place in the store; a page goes on below the last one's.
        plan: None if it is damaged.
        reviews: oldest first.
        needs_review: whether it waits for a decision: it can be accepted, and no decision about it is valid.
        damage: why it cannot be read; empty otherwise.
    """

    number: int
    plan_id: str
    plan: PlanRecord | None
    reviews: tuple[Review, ...] = ()
    needs_review: bool = False
    damage: str = ""


@dataclass(frozen=True)
class ListedScene:
    """A scene of a list.

    Attributes:
        number: its place in the store; a page goes on below the last one's.
        client: who built it first.
        n_bytes: size of the stored scene, compressed.
        created: [s since 1970].
    """

    number: int
    scene_id: str
    client: str
    n_bytes: int
    created: float


class Lists:
    """The plans and scenes of a store as lists."""

    def __init__(self, database: Database, plans: Plans, reviews: Reviews, clock: Callable[[], float]) -> None:
        self._database = database
        self._plans = plans
        self._reviews = reviews
        self._clock = clock

    def find_plans(self, wanted: PlanFilter, n_plans: int, below: int | None = None) -> tuple[ListedPlan, ...]:
        """Return at most ``n_plans`` plans, newest first; with ``below``, of smaller numbers only.

        A damaged plan is in the list with its damage, so that one of them does not hide all others.
        """
        conditions = ["created >= :since"]
        if below is not None:
            conditions.append("number < :below")
        if wanted.client:
            conditions.append("client = :client")
        if wanted.kind:
            conditions.append("kind = :kind")
        else:
            conditions.append("kind != :direct")
        if wanted.states:
            names = sorted(state.value for state in wanted.states)
            conditions.append(f"state IN ({', '.join(repr(name) for name in names)})")
        if wanted.needs_review:
            conditions.append(_NEEDS_REVIEW)
        texts = {"client": wanted.client, "kind": wanted.kind, "direct": DIRECT}
        with self._database.reading() as db:
            rows = db.execute(
                f"SELECT number, plan_id, {_NEEDS_REVIEW} AS needs_review FROM plans "
                f"WHERE {' AND '.join(conditions)} ORDER BY number DESC LIMIT :n",
                {**texts, "since": wanted.since, "below": below, "now": self._clock(), "n": n_plans},
            ).fetchall()
        return tuple(self._read(row["number"], row["plan_id"], bool(row["needs_review"])) for row in rows)

    def needs_review(self, plan_id: str) -> bool:
        """Return whether a plan waits for a decision."""
        with self._database.reading() as db:
            row = db.execute(
                f"SELECT {_NEEDS_REVIEW} AS needs_review FROM plans WHERE plan_id = :plan_id",
                {"plan_id": plan_id, "now": self._clock(), "direct": DIRECT},
            ).fetchone()
        return row is not None and bool(row["needs_review"])

    def _read(self, number: int, plan_id: str, needs_review: bool) -> ListedPlan:
        try:
            return ListedPlan(number, plan_id, self._plans.get(plan_id), self._reviews.find(plan_id), needs_review)
        except DamagedError as error:
            return ListedPlan(number, plan_id, None, damage=str(error))

    def find_scenes(
        self, client: str = "", since: float = 0.0, n_scenes: int = 50, below: int | None = None
    ) -> tuple[ListedScene, ...]:
        """Return at most ``n_scenes`` scenes, newest first.

        Args:
            client: who built them first; empty for all.
            since: when they were built, at the earliest [s since 1970].
            below: the number of the last scene of the page before.
        """
        with self._database.reading() as db:
            rows = db.execute(
                "SELECT rowid, scene_id, client, length(data) AS n_bytes, created FROM scenes WHERE created >= :since "
                "AND (:client = '' OR client = :client) AND (:below IS NULL OR rowid < :below) "
                "ORDER BY rowid DESC LIMIT :n",
                {"since": since, "client": client, "below": below, "n": n_scenes},
            ).fetchall()
        return tuple(
            ListedScene(row["rowid"], row["scene_id"], row["client"], row["n_bytes"], row["created"]) for row in rows
        )
