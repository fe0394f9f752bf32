"""What the streams of a server come to, event by event."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import grpc

from service.client.errors import PlannerError
from service.client.received import ReceivedFiles
from service.proto.planner.v1.planner_pb2 import (
    BuildSceneResponse,
    BuiltScene,
    GetPlanResponse,
    PlanAccepted,
    PlanFinished,
    PlanRecord,
    PlanResponse,
)
from service.proto.planner.v1.result_pb2 import FileChunk, MotionResult, Verdict
from service.wire.hashes import hash_certificate, hash_trajectory


@dataclass(frozen=True)
class FinishedPlan:
    """A plan with its verdict.

    Attributes:
        plan_id: the server's, for ``get_plan`` and ``review``.
        request_id: the client's; asking again with it gives the same plan.
        result: verdict, trajectory, certificate.
        is_known: whether it was asked for before.
        folder: with the result's files; None if they were not asked for.
    """

    plan_id: str
    request_id: str
    result: MotionResult
    is_known: bool
    folder: Path | None = None

    @property
    def verdict(self) -> str:
        """``CERTIFIED``, ``NOT_FOUND``, ..."""
        return verdict_of(self.result)


@dataclass(frozen=True)
class StoredPlan:
    """A plan as the server keeps it; ``folder`` has its files, if they were asked for."""

    record: PlanRecord
    folder: Path | None = None

    @property
    def verdict(self) -> str:
        """``CERTIFIED``, ``NOT_FOUND``, ...; empty while there is none."""
        return verdict_of(self.record.result) if self.record.HasField("result") else ""


class PlanReader:
    """Reads ``Plan``: the last attempt's events count.

    Args:
        files: where files go; None if there is no place for any.
        folder: where they will be seen.
    """

    def __init__(self, files: ReceivedFiles | None = None, folder: Path | None = None) -> None:
        self._files, self._folder = files, folder
        self._accepted = PlanAccepted()
        self._finished: PlanFinished | None = None

    def take(self, event: PlanResponse) -> None:
        """The next event.

        Raises:
            PlannerError: it holds what cannot be.
        """
        match event.WhichOneof("event"):
            case "accepted":
                self._accepted, self._finished = event.accepted, None
                _restart(self._files)
            case "finished":
                check_result(event.finished.result)
                self._finished = event.finished
            case "file":
                _write(self._files, event.file)
            case _:
                pass  # queued, progress, or of a later version

    def finished(self) -> FinishedPlan:
        """What it came to.

        Raises:
            PlannerError: the stream ended before the plan did.
        """
        if self._finished is None:
            raise _incomplete("a plan")
        folder = _complete(self._files, self._folder)
        accepted = self._accepted
        return FinishedPlan(
            self._finished.plan_id, accepted.request_id, self._finished.result, accepted.is_known, folder
        )


class StoredReader:
    """Reads ``GetPlan``; arguments as of ``PlanReader``."""

    def __init__(self, files: ReceivedFiles | None = None, folder: Path | None = None) -> None:
        self._files, self._folder = files, folder
        self._record: PlanRecord | None = None

    def take(self, part: GetPlanResponse) -> None:
        """The next part.

        Raises:
            PlannerError: it holds what cannot be.
        """
        match part.WhichOneof("part"):
            case "record":
                if part.record.HasField("result"):
                    check_result(part.record.result)
                self._record = part.record
                _restart(self._files)
            case "file":
                _write(self._files, part.file)
            case _:
                pass

    def finished(self) -> StoredPlan:
        """The plan.

        Raises:
            PlannerError: the stream ended before it came.
        """
        if self._record is None:
            raise _incomplete("a plan")
        return StoredPlan(self._record, _complete(self._files, self._folder))


class SceneReader:
    """Reads ``BuildScene``."""

    def __init__(self) -> None:
        self._scene: BuiltScene | None = None

    def take(self, event: BuildSceneResponse) -> None:
        """The next event."""
        if event.HasField("scene"):
            self._scene = event.scene

    def finished(self) -> BuiltScene:
        """The scene.

        Raises:
            PlannerError: the stream ended before it came.
        """
        if self._scene is None:
            raise _incomplete("a scene")
        return self._scene


def verdict_of(result: MotionResult) -> str:
    """The verdict's name as ``result.json`` writes it.

    Raises:
        PlannerError: it is none that this version knows.
    """
    if result.verdict not in Verdict.values() or result.verdict == Verdict.VERDICT_UNSPECIFIED:
        raise PlannerError(
            grpc.StatusCode.DATA_LOSS, f"the server told a verdict with the unknown number {result.verdict}"
        )
    return Verdict.Name(result.verdict).removeprefix("VERDICT_")


def check_result(result: MotionResult) -> None:
    """
    Raises:
        PlannerError: its verdict is unknown, or its hashes, which reviews are bound to, are of something else.
    """
    verdict_of(result)
    told, found = result.trajectory.sha256, ""
    if result.HasField("trajectory"):
        motion = result.trajectory
        found = hash_trajectory(motion.joint_names, motion.times, motion.positions)
    if told != found:
        raise PlannerError(
            grpc.StatusCode.DATA_LOSS, f"the trajectory's hash is {found or 'none'}, not {told or 'none'}"
        )
    told, found = result.certificate.sha256, ""
    if result.HasField("certificate"):
        found = hash_certificate(result.certificate.json)
    if told != found:
        raise PlannerError(
            grpc.StatusCode.DATA_LOSS, f"the certificate's hash is {found or 'none'}, not {told or 'none'}"
        )


def _restart(files: ReceivedFiles | None) -> None:
    if files is not None:
        files.restart()


def _write(files: ReceivedFiles | None, chunk: FileChunk) -> None:
    if files is not None:
        files.take(chunk)


def _complete(files: ReceivedFiles | None, folder: Path | None) -> Path | None:
    if files is None:
        return None
    files.finish()
    return folder if files.any else None


def _incomplete(what: str) -> PlannerError:
    return PlannerError(grpc.StatusCode.DATA_LOSS, f"the server ended the call without {what}")
