"""The certificate as data: JSON there and back, hashes, and the program that replays it."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hull_reference import hull_distance
from scipy.spatial import ConvexHull
from small_robots import box
from stranger import load_checker

from costs.curve import Curve
from costs.robot import MechanismJoint, load_robot, with_mechanism
from costs.scene import ConvexPiece, Scene
from service.motion.timing import TimingSettings, slow_until_zmp_inside, time_curve
from service.result.motion_json import motion_json
from service.verify import Certificate, Motion, Phase, PlantedContact, Status, SupportPolygon, VerifyError, verify
from service.verify.hashes import bodies_hash, link_vertices, scene_hash
from service.verify.prepared_motion import ForwardKinematics

EXAMPLES = Path(__file__).parents[2] / "examples"
FEET = ("l_foot", "r_foot")


def _wave() -> Motion:
    """Atlas raises an arm past a box, turns a wheel, and keeps its feet where they are."""
    atlas = load_robot("atlas")
    robot = with_mechanism(
        atlas,
        [
            MechanismJoint(
                name="wheel_turn",
                link="wheel",
                origin=np.array([1.2, 0.0, 1.0]),
                axis=np.array([1.0, 0.0, 0.0]),
                bodies={"wheel/rim/1": box("", (1.2, 0.0, 1.2), (0.02, 0.1, 0.02)).vertices},
                lower=-6.0,
                upper=6.0,
                velocity=2.0,
                acceleration=2.0,
            )
        ],
    )
    stand = np.append(atlas.postures["stand"], 0.0)
    rows = np.tile(stand, (4, 1))
    s = np.linspace(0.0, 1.0, 4)
    rows[:, robot.joint_names.index("l_arm_shx")] -= 0.2 * s
    rows[:, robot.joint_names.index("l_arm_ely")] -= 0.5 * np.sin(np.pi * s)
    rows[:, -1] = 1.5 * s
    curve = Curve(np.arange(4.0), rows, np.gradient(rows, axis=0))
    placed = ForwardKinematics(robot.model).at(stand[None])
    contacts, corners = [], []
    for foot in FEET:
        frame = robot.model.frames[robot.model.getFrameId(foot)]
        body = next(body for body in robot.bodies if body.link == foot)
        sole = link_vertices(robot, foot, body.vertices)
        sole = sole[sole[:, 2] < sole[:, 2].min() + 1e-6]
        pose = np.eye(4)
        pose[:3, :3] = placed.rotation[0, frame.parentJoint] @ frame.placement.rotation
        pose[:3, 3] = (
            placed.rotation[0, frame.parentJoint] @ frame.placement.translation
            + placed.translation[0, frame.parentJoint]
        )
        contacts.append(PlantedContact(foot, pose, sole))
        corners.append(sole @ pose[:3, :3].T + pose[:3, 3])
    ground = np.vstack(corners)
    polygon = ground[ConvexHull(ground[:, :2]).vertices, :2]
    height = float(ground[:, 2].mean())
    support = SupportPolygon(polygon, 0.02, height)
    law = time_curve(robot, curve, settings=TimingSettings(0.3, 0.3, support_links=FEET))
    hand = next(body for body in robot.bodies if body.link == "l_hand")
    centre = _hand_half_way(robot, curve, hand.joint, hand.vertices)
    floor = ConvexPiece("floor", box("", (0.0, 0.0, height - 0.102), (2.0, 2.0, 0.1)).vertices, "floor")
    scene = Scene((box("post", (centre[0] + 0.5, centre[1], centre[2]), (0.1, 0.1, 0.3)), floor))
    phases = (
        Phase("raise", 0.0, 2.0, tuple(contacts), support=support),
        Phase("lower", 2.0, 3.0, tuple(contacts), support=support),
    )
    samples = np.linspace(0.0, 3.0, 121)
    motion = Motion(robot, scene, curve, law, phases, samples, robot.mechanism_links)
    return replace(motion, law=slow_until_zmp_inside(motion))


def _hand_half_way(robot: Any, curve: Curve, joint: int, vertices: np.ndarray) -> np.ndarray:
    """Where the hand is half-way."""
    placed = ForwardKinematics(robot.model).at(curve(np.array([1.5])))
    return np.asarray((vertices @ placed.rotation[0, joint].T + placed.translation[0, joint]).mean(axis=0))


@pytest.fixture(scope="module")
def motion() -> Motion:
    return _wave()


@pytest.fixture(scope="module")
def certificate(motion: Motion) -> Certificate:
    return verify(motion)


@pytest.fixture(scope="module")
def result(motion: Motion, certificate: Certificate) -> dict[str, Any]:
    """What a result file holds, as far as the replay reads it."""
    robot = load_robot("atlas")
    return {
        "verdict": certificate.status.value,
        "request": {},
        "request_hash": "sha256:" + hashlib.sha256(b"{}").hexdigest(),
        "robot": {"urdf": "robot.urdf", "root": "floating"},
        "bodies": [
            {"name": b.name, "link": b.link, "vertices": link_vertices(robot, b.link, b.vertices).tolist()}
            for b in robot.bodies
        ],
        "ignored_pairs": sorted(list(pair) for pair in robot.ignored_pairs),
        "pieces": [{"name": p.name, "kind": p.kind, "vertices": p.vertices.tolist()} for p in motion.scene.pieces],
        **motion_json(motion, robot),
        "certificate": certificate.to_dict(),
    }


def _write(folder: Path, result: dict[str, Any]) -> None:
    (folder / "result.json").write_text(json.dumps(result))
    (folder / "robot.urdf").write_text(load_robot("atlas").source.urdf)
    table = np.column_stack([result["trajectory"]["times"], result["trajectory"]["positions"]])
    np.savetxt(
        folder / "trajectory.csv",
        table,
        fmt="%.10g",
        delimiter=",",
        header=",".join(("time", *result["trajectory"]["joint_names"])),
        comments="",
    )


@pytest.fixture(scope="module")
def program() -> ModuleType:
    """The example that replays a certificate."""
    return load_checker()


def test_atlas_raising_an_arm_is_certified(certificate: Certificate) -> None:
    assert certificate.failed() == ()
    assert certificate.status is Status.CERTIFIED
    assert certificate.min_clearance_m > 0.0
    assert certificate.min_balance_margin_m >= 0.02


def test_the_certificate_survives_json(certificate: Certificate) -> None:
    text = certificate.to_json()
    assert Certificate.from_json(text).to_json() == text
    assert len(text) < 1_000_000
    with pytest.raises(VerifyError, match="scopt-certificate/3"):
        Certificate.from_json('{"format": "other"}')


def test_the_rows_cover_their_stretches_without_a_gap(certificate: Certificate) -> None:
    proof = certificate.stretches
    edges = np.array(proof.edges)
    for pair in set(proof.pair):
        own = sorted((a, b) for p, a, b in zip(proof.pair, proof.first, proof.last, strict=True) if p == pair)
        for (_, end), (start, _) in pairwise(own):
            assert end <= start
            assert end == start or (end in edges and start in edges)
    assert np.all(np.array(proof.distance) - np.array(proof.bound) > 0.0)


def test_hashes_change_with_what_they_name(motion: Motion, certificate: Certificate) -> None:
    moved = Scene((box("post", (0.0, 0.0, 3.0), (0.1, 0.1, 0.1)),))
    assert scene_hash(motion.scene) == certificate.scene_sha256 != scene_hash(moved)
    fewer = replace(motion.robot, bodies=motion.robot.bodies[1:])
    assert bodies_hash(motion.robot) == certificate.bodies_sha256 != bodies_hash(fewer)
    looser = replace(motion.robot, ignored_pairs=motion.robot.ignored_pairs | {("a", "b")})
    assert bodies_hash(looser) != certificate.bodies_sha256


def test_the_replay_agrees(tmp_path: Path, result: dict[str, Any]) -> None:
    _write(tmp_path, result)
    command = [sys.executable, str(EXAMPLES / "check_certificate.py"), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "FAIL" not in done.stdout
    assert "clearance" in done.stdout


def _tampered(result: dict[str, Any], what: str) -> dict[str, Any]:
    other: dict[str, Any] = json.loads(json.dumps(result))
    proof = other["certificate"]["stretches"]
    if what == "distance":
        proof["distance"] = [d + 0.001 for d in proof["distance"]]
    elif what == "piece":
        for vertex in other["pieces"][0]["vertices"]:
            vertex[0] -= 0.4
    elif what == "curve":
        column = other["curve"]["joint_names"].index("l_leg_kny")
        for tangent in other["curve"]["tangents"]:
            tangent[column] += 0.1
    elif what == "polygon":
        for phase in other["phases"]:
            phase["support"]["polygon"] = [[x + 0.2, y] for x, y in phase["support"]["polygon"]]
    elif what == "limit":
        column = other["curve"]["joint_names"].index("neck_ry")  # what moves only the head is soon examined through
        for row in other["curve"]["positions"]:
            row[column] -= 2.0
    return other


@pytest.mark.parametrize(
    ("what", "claim"),
    [
        ("distance", "clearance"),
        ("piece", "clearance"),
        ("curve", "l_foot"),
        ("polygon", "balance"),
        ("limit", "limits"),
    ],
)
def test_the_replay_refuses_what_was_tampered_with(
    program: ModuleType,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    result: dict[str, Any],
    what: str,
    claim: str,
) -> None:
    _write(tmp_path, _tampered(result, what))
    assert program.main(tmp_path) == 1
    assert any(line.startswith("FAIL") and claim in line for line in capsys.readouterr().out.splitlines())


def test_the_replay_measures_distances_itself(program: ModuleType) -> None:
    rng = np.random.default_rng(0)
    for _ in range(100):
        a, b = rng.normal(size=(20, 3)), rng.normal(size=(12, 3)) + rng.normal(size=3) * 3.0
        low = program.separation(a, b, np.inf)
        distance = hull_distance(a, b)
        if distance > 1e-4:
            assert distance - 1e-5 <= low <= distance + 1e-9
        else:
            assert low <= 1e-4
