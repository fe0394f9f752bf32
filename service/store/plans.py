"""Stored plans, found by their id or by the client's request id."""

from __future__ import annotations

import secrets
import sqlite3
import tarfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from service.errors import shown
from service.store.archive import PlanArchive
from service.store.database import UNREADABLE_ROW, Database, seal_plan
from service.store.errors import DamagedError, NotStoredError, ReviewRefusedError, TooLargeError
from service.store.folder import LockedFolder
from service.store.records import PlanRecord, PlanState, StoreLimits
from service.store.seals import SEAL, compute_seal, hash_bytes, hash_file

PAGE_NAME = "viewer.html"  # member of an archive
MAX_RESUMED = 2  # restarts after which a plan is begun again; it may be the one that ends the server
_NOT_OPEN = "no open plan has this id: it has its reply, was given up, or never existed"
_RESTARTED = "the server was restarted before the plan finished"
_LATE = "its deadline passed while the server was restarted"
_REPEATED = f"the server was restarted {MAX_RESUMED + 1} times during this plan; it is not begun again"


class Plans:
    """The plans of a store.  Unfinished plans stay open when it is opened, unless they cannot be resumed.

    What is read is compared with the seal of its row, and archives with their hash.

    Args:
        archives: folder of the plans' files.

    Attributes:
        resumable: the open plans at the start, oldest first; each has its ``request``.
    """

    def __init__(
        self, database: Database, archives: LockedFolder, limits: StoreLimits, clock: Callable[[], float]
    ) -> None:
        self._database = database
        self._archives = archives
        self._limits = limits
        self._clock = clock
        with database.transaction() as db:
            self.resumable = tuple(self._list_resumable(db))
            kept = {row["plan_id"] for row in db.execute("SELECT plan_id FROM plans WHERE archive_bytes > 0")}
        for file in archives.files():
            if file.name not in kept:  # its plan was never stored, or was deleted
                file.unlink()
        self._hash_old_archives()

    def find(self, client: str, request_id: str) -> PlanRecord | None:
        """Return the plan of a request that the client sent before; None for an empty id."""
        if not request_id:
            return None
        with self._database.reading() as db:
            return _find(db, client, request_id)

    def begin(
        self,
        client: str,
        request_id: str,
        request_sha256: str,
        kind: str,
        request: bytes = b"",
        deadline: float | None = None,
        lost_sha256: str | None = None,
    ) -> PlanRecord:
        """Store a request, or return the client's plan with the same ``request_id``; a lost one is accepted again.

        Args:
            request_id: unique among the client's requests; a request with an empty one is always new.
            request: what is needed to begin the plan again after a restart; without it the plan is lost then.
            deadline: after which the plan is not begun again [s since 1970]; None for never.
            lost_sha256: another hash of the same request, which a lost plan may have; it then gets ``request_sha256``.

        Raises:
            DamagedError: the stored plan with this ``request_id`` is damaged.
        """
        with self._database.transaction() as db:
            known = _find(db, client, request_id) if request_id else None
            if known is None:
                plan_id = secrets.token_hex(16)
                db.execute(
                    "INSERT INTO plans "
                    "(plan_id, client, request_id, request_sha256, kind, state, created, request, deadline) "
                    "VALUES (?, ?, ?, ?, ?, 'accepted', ?, ?, ?)",
                    (plan_id, client, request_id or None, request_sha256, kind, self._clock(), request, deadline),
                )
                seal_plan(db, plan_id)
                deleted = self._make_space(db, plan_id)
            else:
                plan_id, deleted = known.plan_id, []
                if known.state is PlanState.LOST and known.request_sha256 in (request_sha256, lost_sha256):
                    until = None if deadline is None else float(deadline)
                    again = {"state": "accepted", "why_lost": "", "n_resumed": 0, "request": request, "deadline": until}
                    _change(db, plan_id, {**again, "request_sha256": request_sha256})
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
        page_sha256: str = "",
    ) -> None:
        """Store a reply; it survives the process as soon as this call has returned.

        Raises:
            NotStoredError: no open plan has this id.
            DamagedError: the open plan is not what was stored.
            TooLargeError: reply and archive alone exceed the store's limit.
        """
        n_bytes = len(reply) + len(archive)
        if n_bytes > self._limits.max_bytes:
            raise TooLargeError(f"a reply of {n_bytes} bytes; the store keeps {self._limits.max_bytes} at most")
        if archive:
            if self.get(plan_id).state is not PlanState.ACCEPTED:
                raise NotStoredError(_NOT_OPEN)
            self._archives.write(plan_id, archive)
        changes = {
            "state": "finished",
            "verdict": verdict,
            "reply": reply,
            "plan_sha256": plan_sha256,
            "certificate_sha256": certificate_sha256,
            "page_sha256": page_sha256,
            "archive_sha256": hash_bytes(archive) if archive else "",
            "archive_bytes": len(archive),
            "bytes": n_bytes,
            "request": b"",
        }
        with self._database.transaction() as db:
            _change(db, plan_id, {**changes, "finished": float(self._clock())}, is_open=True)
            deleted = self._make_space(db, plan_id)
        self._delete_archives(deleted)

    def give_up(self, plan_id: str, why: str) -> None:
        """Mark an open plan as lost (refused, cancelled, failed), so that its request may run again.

        Raises:
            NotStoredError: no open plan has this id.
            DamagedError: it is not what was stored.
        """
        with self._database.transaction() as db:
            _change(db, plan_id, {"state": "lost", "why_lost": why[:1000], "request": b""}, is_open=True)

    def get(self, plan_id: str) -> PlanRecord:
        """Return a plan in any state.

        Raises:
            NotStoredError: no plan has this id.
            DamagedError: it is not what was stored.
        """
        with self._database.reading() as db:
            return _read(db, plan_id)

    def require_same(self, db: sqlite3.Connection, plan: PlanRecord) -> None:
        """Check in a transaction that a plan is still as it was read.

        Raises:
            ReviewRefusedError: it was changed or reviewed meanwhile.
        """
        if _read(db, plan.plan_id) != plan:
            raise ReviewRefusedError("the plan was reviewed by somebody else meanwhile; review it again")

    def open_archive(self, plan_id: str) -> PlanArchive:
        """Open the archive of a plan; it stays readable if the plan is deleted meanwhile.

        Raises:
            NotStoredError: no plan has this id, or it has no archive.
            DamagedError: plan or archive are not what was stored.
        """
        return self._open_archive(self.get(plan_id))

    def check_archive(self, plan: PlanRecord) -> None:
        """Check the archive of a plan, if it has one.

        Raises:
            DamagedError: it is not what was stored.
        """
        if plan.archive_bytes:
            self._open_archive(plan).close()

    def _open_archive(self, plan: PlanRecord) -> PlanArchive:
        plan_id = plan.plan_id
        if plan.state is not PlanState.FINISHED:
            raise NotStoredError(f"plan {plan_id} has not finished; there are no files yet")
        if not plan.archive_bytes:
            raise NotStoredError(
                f"plan {plan_id} was planned without files; plan it again with files "
                "(with_files; out= of the Python client)"
            )
        try:
            return PlanArchive(self._archives.path / plan_id, plan.archive_bytes, plan.archive_sha256)
        except OSError as error:
            self.get(plan_id)  # it may have been deleted meanwhile
            raise DamagedError(
                f"plan {plan_id}: its files cannot be read on this server's disk ({error.strerror}); plan it again"
            ) from None

    def _list_resumable(self, db: sqlite3.Connection) -> Iterator[PlanRecord]:
        """Yield the open plans that are begun again; the others become lost."""
        ids = db.execute("SELECT plan_id FROM plans WHERE state IN ('accepted', 'running') ORDER BY number").fetchall()
        for (plan_id,) in ids:
            try:
                plan = _read(db, plan_id)
            except DamagedError:
                continue  # stays open, so that a reader is told
            is_late = plan.deadline is not None and plan.deadline <= self._clock()
            if plan.request and not is_late and plan.n_resumed < MAX_RESUMED:
                _change(db, plan_id, {"n_resumed": plan.n_resumed + 1})
                yield _read(db, plan_id)
            else:
                why = _RESTARTED if not plan.request else _LATE if is_late else _REPEATED
                _change(db, plan_id, {"state": "lost", "why_lost": why, "request": b""})

    def _hash_old_archives(self) -> None:
        """Record the hashes of archives that a version without hashes wrote."""
        with self._database.transaction() as db:
            ids = db.execute("SELECT plan_id FROM plans WHERE archive_bytes > 0 AND archive_sha256 = ''").fetchall()
            for (plan_id,) in ids:
                path = self._archives.path / plan_id
                if not path.is_file():
                    continue  # reported when it is read
                try:
                    hashes = hash_file(path), _hash_page(path)
                except (OSError, tarfile.TarError):
                    continue  # reported when it is read
                db.execute("UPDATE plans SET archive_sha256 = ?, page_sha256 = ? WHERE plan_id = ?", (*hashes, plan_id))
                seal_plan(db, plan_id)

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

    def delete_older(self, before: float, *, with_reviewed: bool) -> int:
        """Delete the plans that were made before a time and are not open; return their number.

        Args:
            before: seconds since 1970.
            with_reviewed: whether plans with reviews are deleted as well.
        """
        kept = "" if with_reviewed else " AND is_reviewed = 0"
        with self._database.transaction(durable=True) as db:
            rows = db.execute(
                f"SELECT plan_id FROM plans WHERE state IN ('finished', 'lost') AND created < ?{kept}", (before,)
            ).fetchall()
            db.executemany("DELETE FROM plans WHERE plan_id = ?", [(row["plan_id"],) for row in rows])
        self._delete_archives([row["plan_id"] for row in rows])
        return len(rows)

    def _delete_archives(self, plan_ids: list[str]) -> None:
        for plan_id in plan_ids:
            (self._archives.path / plan_id).unlink(missing_ok=True)


def _read(db: sqlite3.Connection, plan_id: str) -> PlanRecord:
    row = db.execute("SELECT * FROM plans WHERE plan_id = ?", (plan_id,)).fetchone()
    if row is None:
        raise NotStoredError(f"unknown plan {shown(plan_id)}; it was removed when the store was full, or never was")
    record = _to_record(row)
    if record.plan_id != plan_id:
        raise DamagedError(UNREADABLE_ROW)
    return record


def _find(db: sqlite3.Connection, client: str, request_id: str) -> PlanRecord | None:
    row = db.execute("SELECT * FROM plans WHERE client = ? AND request_id = ?", (client, request_id)).fetchone()
    if row is None:
        return None
    record = _to_record(row)
    if (record.client, record.request_id) != (client, request_id):
        raise DamagedError(UNREADABLE_ROW)
    return record


def _to_record(row: sqlite3.Row) -> PlanRecord:
    _require_sound(row)
    values = {field.name: row[field.name] for field in fields(PlanRecord)}
    return PlanRecord(**{**values, "request_id": row["request_id"] or "", "state": PlanState(row["state"])})


def _require_sound(row: sqlite3.Row) -> None:
    if compute_seal(dict(row)) != row[SEAL]:
        raise DamagedError(
            f"plan {shown(row['plan_id'])}: is damaged on this server's disk; plan it again under a new id"
        )


def _change(db: sqlite3.Connection, plan_id: str, changes: Mapping[str, Any], is_open: bool = False) -> None:
    """Change columns of a plan and seal its row, in one write; a damaged row is not sealed.

    Args:
        changes: value by column, of the type that is read back.
        is_open: whether the plan has to be open.

    Raises:
        NotStoredError: no such plan.
        DamagedError: the row is not what was stored.
    """
    row = db.execute("SELECT * FROM plans WHERE plan_id = ?", (plan_id,)).fetchone()
    if row is None or (is_open and row["state"] != PlanState.ACCEPTED.value):
        raise NotStoredError(_NOT_OPEN)
    _require_sound(row)
    values = {**changes, SEAL: compute_seal({**dict(row), **changes})}
    columns = ", ".join(f"{name} = ?" for name in values)
    db.execute(f"UPDATE plans SET {columns} WHERE plan_id = ?", (*values.values(), plan_id))


def _hash_page(path: Path) -> str:
    """Return the hash of an archive's page; empty if it has none."""
    with tarfile.open(path, "r:") as archive:
        page = next((member for member in archive if member.name == PAGE_NAME), None)
        content = None if page is None else archive.extractfile(page)
        return "" if content is None else hash_bytes(content.read())
