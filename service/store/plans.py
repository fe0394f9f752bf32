"""Plans from the request to the reply: kept once each, found again by id or by the client's own request id."""

from __future__ import annotations

import secrets
import sqlite3
from collections.abc import Callable
from typing import BinaryIO

from service.errors import shown
from service.store.database import Database
from service.store.errors import NotStoredError, TooLargeError
from service.store.folder import HeldFolder
from service.store.records import Begun, Outcome, PlanRecord, PlanState, StoreLimits

_COLUMNS = (
    "plan_id, client, ifnull(request_id, '') AS request_id, request_sha256, kind, state, why_lost, verdict, reply, "
    "plan_sha256, certificate_sha256, archive_bytes, created, finished"
)
_NOT_OPEN = "no plan of that id is open: it has had its reply, was given up, or never was"
_RESTARTED = "the server was restarted before it finished"


class Plans:
    """The plans of a store; at its opening, all that did not finish are lost, and may run again.

    Args:
        archives: the folder of what belongs to a plan and is too large for a row.
    """

    def __init__(
        self, database: Database, archives: HeldFolder, limits: StoreLimits, clock: Callable[[], float]
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
            if file.name not in kept:  # its plan never came, or has gone
                file.unlink()

    def find(self, client: str, request_id: str) -> PlanRecord | None:
        """The plan of a request that the client has sent before; None where there is none, or no id to know it by."""
        if not request_id:
            return None
        with self._database.transaction() as db:
            row = db.execute(
                f"SELECT {_COLUMNS} FROM plans WHERE client = ? AND request_id = ?", (client, request_id)
            ).fetchone()
        return None if row is None else _record(row)

    def begin(self, client: str, request_id: str, request_sha256: str, kind: str) -> Begun:
        """Take a request in, unless the client has sent it before.

        Args:
            request_id: unique among the client's requests; an empty one is never found again.
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
                gone = self._make_room(db, plan_id)
                outcome = Outcome.NEW
            else:
                plan_id, gone = row["plan_id"], []
                outcome = _met_again(row, request_sha256)
                if outcome is Outcome.NEW:
                    db.execute("UPDATE plans SET state = 'accepted', why_lost = '' WHERE plan_id = ?", (plan_id,))
            record = _one(db, plan_id)
        self._remove(gone)
        return Begun(outcome, record)

    def running(self, plan_id: str) -> None:
        """An accepted plan is being worked on.

        Raises:
            NotStoredError: no plan of that id is open.
        """
        with self._database.transaction() as db:
            _open(db.execute("UPDATE plans SET state = 'running' WHERE plan_id = ? AND state = 'accepted'", (plan_id,)))

    def finish(
        self,
        plan_id: str,
        verdict: str,
        reply: bytes,
        plan_sha256: str = "",
        certificate_sha256: str = "",
        archive: bytes = b"",
    ) -> None:
        """Keep a reply; from the return of this call on it survives the process.

        Raises:
            NotStoredError: no plan of that id is open: it has had its reply, or was given up.
            TooLargeError: reply and archive alone are more than the store keeps.
        """
        n_bytes = len(reply) + len(archive)
        if n_bytes > self._limits.max_bytes:
            raise TooLargeError(f"a reply of {n_bytes} bytes; the store keeps {self._limits.max_bytes} at most")
        if archive:
            if self.get(plan_id).state not in (PlanState.ACCEPTED, PlanState.RUNNING):
                raise NotStoredError(_NOT_OPEN)
            self._archives.write(plan_id, archive)
        with self._database.transaction() as db:
            _open(
                db.execute(
                    "UPDATE plans SET state = 'finished', verdict = ?, reply = ?, plan_sha256 = ?, "
                    "certificate_sha256 = ?, archive_bytes = ?, bytes = ?, finished = ? "
                    "WHERE plan_id = ? AND state IN ('accepted', 'running')",
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
            gone = self._make_room(db, plan_id)
        self._remove(gone)

    def give_up(self, plan_id: str, why: str) -> None:
        """An open plan will have no reply (refused, cancelled, failed): its request may run again.

        Raises:
            NotStoredError: no plan of that id is open.
        """
        with self._database.transaction() as db:
            _open(
                db.execute(
                    "UPDATE plans SET state = 'lost', why_lost = ? "
                    "WHERE plan_id = ? AND state IN ('accepted', 'running')",
                    (why[:1000], plan_id),
                )
            )

    def get(self, plan_id: str) -> PlanRecord:
        """A plan in whatever state.

        Raises:
            NotStoredError: there is none of that id.
        """
        with self._database.transaction() as db:
            return _one(db, plan_id)

    def open_archive(self, plan_id: str) -> BinaryIO:
        """The archive of a plan; it can be read to its end even if the plan goes meanwhile.

        Raises:
            NotStoredError: no plan of that id, or one without an archive.
        """
        plan = self.get(plan_id)
        if plan.state is not PlanState.FINISHED:
            raise NotStoredError(f"plan {plan_id} has not finished; there are no files yet")
        if not plan.archive_bytes:
            raise NotStoredError(
                f"plan {plan_id} was planned without files; have it planned anew with them "
                "(with_files; out= of the Python client)"
            )
        try:
            return (self._archives.path / plan_id).open("rb")
        except OSError as error:
            raise NotStoredError(f"the archive of plan {plan_id} cannot be read ({error.strerror})") from None

    def _make_room(self, db: sqlite3.Connection, newest: str) -> list[str]:
        """Let the oldest go, reviewed ones last and the newest not at all; returns which had archives."""
        n, size = db.execute("SELECT n, bytes FROM totals WHERE what = 'plans'").fetchone()
        if n <= self._limits.max_plans and size <= self._limits.max_bytes:
            return []
        gone, archives = [], []
        for plan_id, n_bytes, archive_bytes in db.execute(
            "SELECT plan_id, bytes, archive_bytes FROM plans INDEXED BY plans_by_age "
            "WHERE state IN ('finished', 'lost') AND plan_id != ? ORDER BY is_reviewed, number",
            (newest,),
        ):
            if n <= self._limits.max_plans and size <= self._limits.max_bytes:
                break
            n, size = n - 1, size - n_bytes
            gone.append((plan_id,))
            if archive_bytes:
                archives.append(plan_id)
        db.executemany("DELETE FROM plans WHERE plan_id = ?", gone)
        return archives

    def _remove(self, archives: list[str]) -> None:
        for plan_id in archives:
            (self._archives.path / plan_id).unlink(missing_ok=True)


def _met_again(row: sqlite3.Row, request_sha256: str) -> Outcome:
    if row["request_sha256"] != request_sha256:
        return Outcome.CONFLICT
    if row["state"] == PlanState.LOST:
        return Outcome.NEW
    return Outcome.FINISHED if row["state"] == PlanState.FINISHED else Outcome.RUNNING


def _one(db: sqlite3.Connection, plan_id: str) -> PlanRecord:
    row = db.execute(f"SELECT {_COLUMNS} FROM plans WHERE plan_id = ?", (plan_id,)).fetchone()
    if row is None:
        raise NotStoredError(f"no plan {shown(plan_id)}; it never was, or went when the store was full")
    return _record(row)


def _record(row: sqlite3.Row) -> PlanRecord:
    return PlanRecord(**{**dict(row), "state": PlanState(row["state"])})


def _open(changed: sqlite3.Cursor) -> None:
    if changed.rowcount != 1:
        raise NotStoredError(_NOT_OPEN)
