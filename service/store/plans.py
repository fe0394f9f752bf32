"""Stored plans, found by their id or by the client's request id."""

from __future__ import annotations

import secrets
import sqlite3
from collections.abc import Callable
from typing import BinaryIO

from service.errors import shown
from service.store.database import Database
from service.store.errors import NotStoredError, TooLargeError
from service.store.folder import LockedFolder
from service.store.records import PlanRecord, PlanState, StoreLimits

_COLUMNS = (
    "plan_id, client, ifnull(request_id, '') AS request_id, request_sha256, kind, state, why_lost, verdict, reply, "
    "plan_sha256, certificate_sha256, archive_bytes, created, finished"
)
_NOT_OPEN = "no open plan has this id: it has its reply, was given up, or never existed"
_RESTARTED = "the server was restarted before the plan finished"


class Plans:
    """The plans of a store; opening it marks all unfinished plans as lost, so that they may run again.

    Args:
        archives: folder of the plans' files.
    """

    def __init__(
        self, database: Database, archives: LockedFolder, limits: StoreLimits, clock: Callable[[], float]
    ) -> None:
        self._database = database
        self._archives = archives
        self._limits = limits
        self._clock = clock
        with database.transaction() as db:
            db.execute(
                "UPDATE plans SET state = 'lost', why_lost = ? WHERE state IN ('accepted', 'running')", (_RESTARTED,)
            )
            kept = {row["plan_id"] for row in db.execute("SELECT plan_id FROM plans WHERE archive_bytes > 0")}
        for file in archives.files():
            if file.name not in kept:  # its plan was never stored, or was deleted
                file.unlink()

    def find(self, client: str, request_id: str) -> PlanRecord | None:
        """Return the plan of a request that the client sent before; None for an empty id."""
        if not request_id:
            return None
        with self._database.transaction() as db:
            row = db.execute(
                f"SELECT {_COLUMNS} FROM plans WHERE client = ? AND request_id = ?", (client, request_id)
            ).fetchone()
        return None if row is None else _to_record(row)

    def begin(self, client: str, request_id: str, request_sha256: str, kind: str) -> PlanRecord:
        """Store a request, or return the client's plan with the same ``request_id``; a lost one is accepted again.

        Args:
            request_id: unique among the client's requests; a request with an empty one is always new.
        """
        with self._database.transaction() as db:
            row = db.execute(
                f"SELECT {_COLUMNS} FROM plans WHERE client = ? AND request_id = ?", (client, request_id)
            ).fetchone()
            if row is None:
                plan_id = secrets.token_hex(16)
                db.execute(
                    "INSERT INTO plans (plan_id, client, request_id, request_sha256, kind, state, created) "
                    "VALUES (?, ?, ?, ?, ?, 'accepted', ?)",
                    (plan_id, client, request_id or None, request_sha256, kind, self._clock()),
                )
                deleted = self._make_space(db, plan_id)
            else:
                plan_id, deleted = row["plan_id"], []
                if row["state"] == PlanState.LOST and row["request_sha256"] == request_sha256:
                    db.execute("UPDATE plans SET state = 'accepted', why_lost = '' WHERE plan_id = ?", (plan_id,))
            record = _read(db, plan_id)
        self._delete_archives(deleted)
        return record

    def finish(
        self,
        plan_id: str,
        verdict: str,
        reply: bytes,
        plan_sha256: str = "",
        certificate_sha256: str = "",
        archive: bytes = b"",
    ) -> None:
        """Store a reply; it survives the process as soon as this call has returned.

        Raises:
            NotStoredError: no open plan has this id.
            TooLargeError: reply and archive alone exceed the store's limit.
        """
        n_bytes = len(reply) + len(archive)
        if n_bytes > self._limits.max_bytes:
            raise TooLargeError(f"a reply of {n_bytes} bytes; the store keeps {self._limits.max_bytes} at most")
        if archive:
            if self.get(plan_id).state is not PlanState.ACCEPTED:
                raise NotStoredError(_NOT_OPEN)
            self._archives.write(plan_id, archive)
        with self._database.transaction() as db:
            _require_change(
                db.execute(
                    "UPDATE plans SET state = 'finished', verdict = ?, reply = ?, plan_sha256 = ?, "
                    "certificate_sha256 = ?, archive_bytes = ?, bytes = ?, finished = ? "
                    "WHERE plan_id = ? AND state = 'accepted'",
                    (
                        verdict,
                        reply,
                        plan_sha256,
                        certificate_sha256,
                        len(archive),
                        n_bytes,
                        self._clock(),
                        plan_id,
                    ),
                )
            )
            deleted = self._make_space(db, plan_id)
        self._delete_archives(deleted)

    def give_up(self, plan_id: str, why: str) -> None:
        """Mark an open plan as lost (refused, cancelled, failed), so that its request may run again.

        Raises:
            NotStoredError: no open plan has this id.
        """
        with self._database.transaction() as db:
            _require_change(
                db.execute(
                    "UPDATE plans SET state = 'lost', why_lost = ? WHERE plan_id = ? AND state = 'accepted'",
                    (why[:1000], plan_id),
                )
            )

    def get(self, plan_id: str) -> PlanRecord:
        """Return a plan in any state.

        Raises:
            NotStoredError: no plan has this id.
        """
        with self._database.transaction() as db:
            return _read(db, plan_id)

    def open_archive(self, plan_id: str) -> BinaryIO:
        """Open the archive of a plan; it stays readable if the plan is deleted meanwhile.

        Raises:
            NotStoredError: no plan has this id, or it has no archive.
        """
        plan = self.get(plan_id)
        if plan.state is not PlanState.FINISHED:
            raise NotStoredError(f"plan {plan_id} has not finished; there are no files yet")
        if not plan.archive_bytes:
            raise NotStoredError(
                f"plan {plan_id} was planned without files; plan it again with files "
                "(with_files; out= of the Python client)"
            )
        try:
            return (self._archives.path / plan_id).open("rb")
        except OSError as error:
            raise NotStoredError(f"plan {plan_id}: its archive cannot be read ({error.strerror})") from None

    def _make_space(self, db: sqlite3.Connection, newest: str) -> list[str]:
        """Delete the oldest plans, reviewed ones last and the newest never; returns the ids of those with archives."""
        n, size = db.execute("SELECT n, bytes FROM totals WHERE what = 'plans'").fetchone()
        if n <= self._limits.max_plans and size <= self._limits.max_bytes:
            return []
        deleted, archives = [], []
        for plan_id, n_bytes, archive_bytes in db.execute(
            "SELECT plan_id, bytes, archive_bytes FROM plans INDEXED BY plans_by_age "
            "WHERE state IN ('finished', 'lost') AND plan_id != ? ORDER BY is_reviewed, number",
            (newest,),
        ):
            if n <= self._limits.max_plans and size <= self._limits.max_bytes:
                break
            n, size = n - 1, size - n_bytes
            deleted.append((plan_id,))
            if archive_bytes:
                archives.append(plan_id)
        db.executemany("DELETE FROM plans WHERE plan_id = ?", deleted)
        return archives

    def _delete_archives(self, plan_ids: list[str]) -> None:
        for plan_id in plan_ids:
            (self._archives.path / plan_id).unlink(missing_ok=True)


def _read(db: sqlite3.Connection, plan_id: str) -> PlanRecord:
    row = db.execute(f"SELECT {_COLUMNS} FROM plans WHERE plan_id = ?", (plan_id,)).fetchone()
    if row is None:
        raise NotStoredError(f"unknown plan {shown(plan_id)}; it was removed when the store was full, or never was")
    return _to_record(row)


def _to_record(row: sqlite3.Row) -> PlanRecord:
    return PlanRecord(**{**dict(row), "state": PlanState(row["state"])})


def _require_change(update: sqlite3.Cursor) -> None:
    if update.rowcount != 1:
        raise NotStoredError(_NOT_OPEN)
