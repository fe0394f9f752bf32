"""Answers of a server: plans and scenes read from streams of events, with hashes computed again."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import grpc

from service.client.errors import PlannerError
from service.client.received import ReceivedFiles
from service.proto.planner.v1.execution_pb2 import WatchResponse
from service.proto.planner.v1.planner_pb2 import (
    BuildSceneResponse,
    BuiltScene,
    Decision,
    GetPlanResponse,
    PlanAccepted,
    PlanFinished,
    PlanRecord,
    PlanResponse,
)
from service.proto.planner.v1.result_pb2 import Certificate, FileChunk, MotionResult, Verdict
from service.result.folder import APPROVAL_NAME, FORMAT, REVOCATION_NAME, VIEWER_NAME
from service.wire.hashes import hash_certificate, hash_trajectory
from service.wire.plain import to_plain


@dataclass(frozen=True)
class FinishedPlan:
    """Plan with its verdict.

    Attributes:
        plan_id: the server's id, for ``get_plan`` and ``review``.
        request_id: the client's id; the same id gives the same plan again.
        result: verdict, trajectory, certificate.
        is_known: whether it was requested before.
        folder: folder of the result's files; None if none were requested.
    """

    plan_id: str
    request_id: str
    result: MotionResult
    is_known: bool
    folder: Path | None = None

    @property
    def verdict(self) -> str:
        """``CERTIFIED``, ``NOT_FOUND``, ..."""
        return read_verdict(self.result)


@dataclass(frozen=True)
class StoredPlan:
    """Plan in the server's store; ``folder`` has its files, if they were requested."""

    record: PlanRecord
    folder: Path | None = None

    @property
    def verdict(self) -> str:
        """``CERTIFIED``, ``NOT_FOUND``, ...; empty while the plan runs."""
        return read_verdict(self.record.result) if self.record.HasField("result") else ""


class _FolderReader:
    """Base of the readers whose streams contain files.

    Args:
        files: writer of the files; None if none are requested.
        folder: folder that the files will be in.
    """

    def __init__(self, files: ReceivedFiles | None = None, folder: Path | None = None) -> None:
        self._files, self._folder = files, folder

    def _restart(self) -> None:
        if self._files is not None:
            self._files.restart()

    def _write(self, chunk: FileChunk) -> None:
        if self._files is not None:
            self._files.take(chunk)

    def _finish_files(self) -> Path | None:
        if self._files is None:
            return None
        self._files.finish()
        return self._folder if self._files.any else None


class PlanReader(_FolderReader):
    """Reader of the events of ``Plan``; those of the last attempt count."""

    def __init__(self, files: ReceivedFiles | None = None, folder: Path | None = None) -> None:
        super().__init__(files, folder)
        self._accepted = PlanAccepted()
        self._finished: PlanFinished | None = None

    def take(self, event: PlanResponse) -> None:
        """Read the next event.

        Raises:
            PlannerError: a wrong hash, an unknown verdict, or a wrong file.
        """
        match event.WhichOneof("event"):
            case "accepted":
                self._accepted, self._finished = event.accepted, None
                self._restart()
            case "finished":
                check_result(event.finished.result)
                self._finished = event.finished
            case "file":
                self._write(event.file)
            case _:
                pass  # queued, progress, or of a later version

    def finish(self) -> FinishedPlan:
        """Return the plan.

        Raises:
            PlannerError: the stream ended before the plan did.
        """
        if self._finished is None:
            raise _incomplete("a plan")
        folder = self._finish_files()
        accepted = self._accepted
        return FinishedPlan(
            self._finished.plan_id, accepted.request_id, self._finished.result, accepted.is_known, folder
        )


class WatchReader:
    """Reader of ``Watch``: the whole state of the robot after each change."""

    def __init__(self) -> None:
        self._state = WatchResponse()

    def take(self, change: WatchResponse) -> WatchResponse:
        """Return the state after a change; a snapshot replaces everything."""
        state = WatchResponse()
        if not change.is_snapshot:
            state.CopyFrom(self._state)
        for field, value in change.ListFields():
            if field.message_type is None:
                setattr(state, field.name, value)
            else:
                getattr(state, field.name).CopyFrom(value)
        state.is_snapshot = True
        self._state = state
        return state


class StoredReader(_FolderReader):
    """Reader of the parts of ``GetPlan``."""

    def __init__(self, files: ReceivedFiles | None = None, folder: Path | None = None) -> None:
        super().__init__(files, folder)
        self._record: PlanRecord | None = None

    def take(self, part: GetPlanResponse) -> None:
        """Read the next part.

        Raises:
            PlannerError: a wrong hash, an unknown verdict, or a wrong file.
        """
        match part.WhichOneof("part"):
            case "record":
                if part.record.HasField("result"):
                    check_result(part.record.result)
                self._record = part.record
                self._restart()
            case "file":
                self._write(part.file)
            case _:
                pass  # of a later version

    def finish(self) -> StoredPlan:
        """Return the plan.

        Raises:
            PlannerError: the stream ended before the plan came, or the page is not the record's.
        """
        if self._record is None:
            raise _incomplete("a plan")
        if self._files is not None and self._files.any:
            page = self._files.read(VIEWER_NAME)
            if self._record.page_sha256:  # servers of an earlier version send none
                _check_hash("page", self._record.page_sha256, "" if page is None else hashlib.sha256(page).hexdigest())
            for name, statement in select_statements(self._record).items():
                self._write(FileChunk(path=name, data=statement, is_last=True))
        return StoredPlan(self._record, self._finish_files())


def select_statements(record: PlanRecord) -> dict[str, bytes]:
    """Return the signed statements about a plan by file name: the newest approval, and its revocation if there is one.

    An approval that was withdrawn without a signature, on a server without a key, is left out.
    """
    reviews = list(record.reviews)
    accepted = [k for k, review in enumerate(reviews) if review.decision == Decision.DECISION_ACCEPTED]
    if not accepted or not reviews[accepted[-1]].approval:
        return {}
    found = {APPROVAL_NAME: reviews[accepted[-1]].approval}
    if accepted[-1] == len(reviews) - 1:
        return found
    revocation = reviews[accepted[-1] + 1].approval  # the first review after an acceptance withdraws it
    return {**found, REVOCATION_NAME: revocation} if revocation else {}


class SceneReader:
    """Reader of the events of ``BuildScene``."""

    def __init__(self) -> None:
        self._scene: BuiltScene | None = None

    def take(self, event: BuildSceneResponse) -> None:
        """Read the next event."""
        if event.HasField("scene"):
            self._scene = event.scene

    def finish(self) -> BuiltScene:
        """Return the scene.

        Raises:
            PlannerError: the stream ended before the scene came.
        """
        if self._scene is None:
            raise _incomplete("a scene")
        return self._scene


def read_verdict(result: MotionResult) -> str:
    """Return the verdict's name as ``result.json`` has it.

    Raises:
        PlannerError: this version does not know the verdict.
    """
    if result.verdict not in Verdict.values() or result.verdict == Verdict.VERDICT_UNSPECIFIED:
        raise _broken_answer(f"the verdict has the unknown number {result.verdict}")
    return Verdict.Name(result.verdict).removeprefix("VERDICT_")


def check_result(result: MotionResult) -> None:
    """
    Raises:
        PlannerError: the verdict is unknown, or a hash, which reviews are bound to, is wrong.
    """
    read_verdict(result)
    trajectory, certificate = result.trajectory, result.certificate
    _check_hash(
        "trajectory",
        trajectory.sha256,
        hash_trajectory(trajectory.joint_names, trajectory.times, trajectory.positions)
        if result.HasField("trajectory")
        else "",
    )
    _check_hash(
        "certificate",
        certificate.sha256,
        hash_certificate(certificate.json) if result.HasField("certificate") else "",
    )


def summarize(result: MotionResult) -> dict[str, Any]:
    """Return a result with the keys of ``result.json``; ``service.result.result_json.summary_json`` has the same.

    Raises:
        PlannerError: the certificate is no JSON.
    """
    trajectory = result.trajectory if result.HasField("trajectory") else None
    return {
        "format": FORMAT,
        "request_hash": result.request_sha256,
        "verdict": read_verdict(result),
        "explanation": list(result.explanation),
        "conflict": to_plain(result.conflict) if result.HasField("conflict") else None,
        "found_from": result.found_from,
        "notes": list(result.notes),
        "planning_time_s": result.planning_time_s,
        "timings": dict(result.timings),
        **_summarize_certificate(result.certificate),
        "figures": to_plain(result.figures),
        "detections": [to_plain(detection) for detection in result.detections],
        "phases": _list_phases(result),
        "duration_s": trajectory.times[-1] if trajectory is not None and trajectory.times else None,
    }


def _list_phases(result: MotionResult) -> list[dict[str, Any]]:
    """Return the phases of a result; those of an older server have no status."""
    if not result.phases:
        return [
            {"name": phase.name, "start_s": phase.start_s, "end_s": phase.end_s} for phase in result.trajectory.phases
        ]
    return [
        {
            "name": phase.name,
            "status": phase.status,
            "checks": list(phase.checks),
            "start_s": phase.start_s if phase.HasField("start_s") else None,
            "end_s": phase.end_s if phase.HasField("end_s") else None,
        }
        for phase in result.phases
    ]


def _summarize_certificate(certificate: Certificate) -> dict[str, Any]:
    try:
        data = json.loads(certificate.json) if certificate.json else {}
    except (ValueError, RecursionError):
        raise _broken_answer("the certificate is no JSON") from None
    figures = ("min_clearance_m", "min_clearance_pair", "min_balance_margin_m", "coverage")
    return {**{key: data.get(key) for key in figures}, **{key: data.get(key, []) for key in ("checks", "exempt")}}


def _check_hash(name: str, sent: str, computed: str) -> None:
    if sent != computed:
        raise _broken_answer(f"the {name}'s hash is {computed or 'none'}, not {sent or 'none'}")


def _incomplete(content: str) -> PlannerError:
    return _broken_answer(f"the server ended the call without {content}")


def _broken_answer(text: str) -> PlannerError:
    return PlannerError(grpc.StatusCode.DATA_LOSS, text)
