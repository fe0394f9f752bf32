"""Results as messages say what result.json says."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from service.planner import plan
from service.proto.planner.v1.result_pb2 import MotionResult
from service.proto.planner.v1.result_pb2 import Verdict as VerdictMessage
from service.request.file import parse_request
from service.result.result import PlanResult, Verdict
from service.result.result_json import to_result_json
from service.wire.hashes import hash_certificate, hash_trajectory
from service.wire.results import checks_to_messages, encode_verdict, result_to_message
from service.wire.scenes import detections_to_messages, scene_to_message


@pytest.fixture(scope="module")
def result() -> PlanResult:
    goal = {"poses": [{"link": "l_hand", "position": [0.35, 0.45, 1.1]}]}
    return plan(parse_request({"robot": {"name": "atlas"}, "start": {"posture": "stand"}, "goal": goal}))


@pytest.fixture(scope="module")
def message(result: PlanResult) -> MotionResult:
    return MotionResult.FromString(result_to_message(result).SerializeToString())


def test_every_verdict_comes_through_the_wire() -> None:
    numbers = [encode_verdict(verdict.value) for verdict in Verdict]
    assert [VerdictMessage.Name(number) for number in numbers] == [f"VERDICT_{verdict.value}" for verdict in Verdict]


def test_trajectory_is_that_of_the_result_file(result: PlanResult, message: MotionResult) -> None:
    file = to_result_json(result)["trajectory"]
    trajectory = message.trajectory
    assert list(trajectory.joint_names) == file["joint_names"]
    assert list(trajectory.times) == file["times"]
    rows = np.array(trajectory.positions).reshape(len(trajectory.times), -1)
    assert rows.tolist() == file["positions"]
    assert trajectory.sha256 == hash_trajectory(file["joint_names"], file["times"], file["positions"])
    (phase,) = trajectory.phases
    assert (phase.name, phase.start_s, phase.end_s) == ("reach", 0.0, file["times"][-1])


def test_certificate_is_that_of_the_result_file(result: PlanResult, message: MotionResult) -> None:
    file = to_result_json(result)["certificate"]
    assert json.loads(message.certificate.json) == file
    assert message.certificate.sha256 == hash_certificate(message.certificate.json)
    assert list(message.certificate.checks) == checks_to_messages(file["checks"])


def test_result_without_a_motion_has_neither_trajectory_nor_certificate() -> None:
    far = {"poses": [{"link": "l_hand", "position": [9.0, 0.0, 1.0]}]}
    refused = result_to_message(
        plan(parse_request({"robot": {"name": "atlas"}, "start": {"posture": "stand"}, "goal": far}))
    )
    assert refused.verdict == VerdictMessage.VERDICT_INFEASIBLE
    assert refused.explanation
    assert not refused.HasField("trajectory")
    assert not refused.HasField("certificate")


def test_check_without_a_number_has_nan_on_the_wire() -> None:
    data = {"name": "clearance", "ok": True, "value": None, "limit": 0.0, "unit": "m", "text": "-", "basis": "proof"}
    (check,) = checks_to_messages([data])
    assert math.isnan(check.value)


def test_scene_message_carries_pieces_and_its_file() -> None:
    corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    hit = {
        "kind": "valve",
        "confidence": 0.9,
        "pose_world_object": np.eye(4).tolist(),
        "sizes": {"outer_radius": 0.13, "name": "wheel", "unknown": None},
        "residuals": {"rms": 0.002},
    }
    data = {
        "pieces": [{"name": "p0", "kind": "wall", "vertices": corners}],
        "detections": [hit],
        "figures": {"points": 4, "covered_points": 0.99},
        "notes": ["one"],
    }
    text = json.dumps(data).encode()
    message = scene_to_message("scene:1", text)
    assert message.json == text
    assert list(message.pieces[0].vertices) == [number for corner in corners for number in corner]
    assert message.figures["points"] == 4
    assert dict(message.detections[0].sizes) == {"outer_radius": 0.13}
    assert list(detections_to_messages([hit])[0].pose_world_object) == np.eye(4).ravel().tolist()
