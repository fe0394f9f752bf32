"""Planted feet need ground within 3 mm, at the start and in the certificate; a scanned floor is moved to the soles."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import dishonest_robots as dishonest
import numpy as np
import pytest
from tiny_robots import atlas

from costs.robot import RobotError, load_robot
from costs.scene import ConvexPiece, Scene
from service.errors import RequestError
from service.planner import plan
from service.request.file import parse_request
from service.result.result import PlanResult, Verdict
from service.setup.prepare import prepare
from service.start.standing import move_floor_to_soles, sole_corners
from service.verify import Motion, Status, verify
from service.verify.ground import find_ground_gaps

FEET = ("l_foot", "r_foot")


def request(floor: float | bool) -> dict:
    """Atlas lifts a forearm."""
    return {"robot": {"name": "atlas"}, "scene": {"floor": floor}, "goal": {"joints": {"l_arm_elx": 1.0}}}


@cache
def standing() -> PlanResult:
    """A certified motion on a floor at the soles' height."""
    return plan(parse_request(request(True)))


def on_floor(motion: Motion, height: float | None) -> Motion:
    """The motion on a floor whose top is at ``height``, or on none."""
    pieces = [piece for piece in motion.scene.pieces if piece.kind != "floor"]
    floor = next(piece for piece in motion.scene.pieces if piece.kind == "floor")
    if height is not None:
        pieces.append(replace(floor, vertices=floor.vertices + np.array([0.0, 0.0, height])))
    return replace(motion, scene=Scene(tuple(pieces)))


@pytest.mark.parametrize(("height", "gap"), [(-0.012, 12.0), (0.009, 9.0), (0.02, 20.0), (-0.0031, 3.1)])
def test_a_floor_that_is_not_at_the_soles_is_told_at_once(height: float, gap: float) -> None:
    with pytest.raises(RequestError) as caught:
        prepare(parse_request(request(height)))
    side = "below" if height < 0.0 else "above"
    assert len(caught.value.problems) == 2
    for foot, line in zip(FEET, caught.value.problems, strict=True):
        assert f"the ground is {gap:.1f} mm {side} the sole of {foot}; expected at most 3 mm" in line


def test_no_floor_under_planted_feet_is_told_at_once() -> None:
    with pytest.raises(RequestError, match="nothing is below a corner of the sole of l_foot"):
        prepare(parse_request(request(False)))


@pytest.mark.parametrize("height", [-0.0029, 0.0029])
def test_a_floor_within_3_mm_of_the_soles_will_do(height: float) -> None:
    assert plan(parse_request(request(height))).verdict is Verdict.CERTIFIED


@pytest.mark.parametrize("height", [None, -0.012, -0.0031, 0.0031, 0.009])
def test_the_verifier_asks_for_the_same_ground_as_the_start(height: float | None) -> None:
    motion = standing().motion
    assert verify(on_floor(motion, 0.0)).status is Status.CERTIFIED
    certificate = verify(on_floor(motion, height))
    assert certificate.status is Status.VIOLATED
    failed = {check.name for check in certificate.failed() if check.name.startswith("ground.")}
    assert failed == {f"ground.{phase.name}.{foot}" for phase in motion.phases for foot in FEET}


def test_a_sole_drawn_wider_than_its_foot_is_refuted() -> None:
    motion = standing().motion
    phases = tuple(
        replace(phase, contacts=tuple(replace(c, sole=c.sole * [1.5, 1.5, 1.0]) for c in phase.contacts))
        for phase in motion.phases
    )
    certificate = verify(replace(motion, phases=phases))
    assert certificate.status is Status.VIOLATED
    assert any("off the link's shapes" in check.text for check in certificate.failed())


def test_the_gap_of_a_corner_is_measured_to_the_nearest_surface_on_its_vertical() -> None:
    square = np.array([[x, y] for x in (-1.0, 1.0) for y in (-1.0, 1.0)])
    flat = ConvexPiece("flat", np.vstack([np.column_stack([square, np.full(4, z)]) for z in (-0.2, 0.0)]))
    # A ramp that rises by 0.1 m per metre along x, beginning at x = 1.
    ramp = ConvexPiece(
        "ramp", np.array([[x, y, z] for x, z in ((1, 0), (1, -0.2), (3, 0.2), (3, -0.2)) for y in (-1, 1)])
    )
    corners = np.array([[0.0, 0.0, 0.004], [0.5, 0.5, -0.01], [2.0, 0.0, 0.102], [5.0, 0.0, 0.0]])
    assert np.allclose(find_ground_gaps(corners, (flat, ramp)), [0.004, -0.01, 0.002, np.inf], atol=1e-9)
    assert np.all(np.isinf(find_ground_gaps(corners, ())))


def _seen(height: float, tilt: float = 0.0) -> tuple[ConvexPiece, ...]:
    """What a scan might show: a floor, rising by ``tilt`` along y, and a box."""
    square = np.array([[x, y] for x in (-2.0, 2.0) for y in (-2.0, 2.0)])
    top = np.column_stack([square, height + tilt * square[:, 1]])
    floor = ConvexPiece("floor", np.vstack([top, top - [0.0, 0.0, 0.1]]), "floor")
    plate = np.column_stack([0.1 * square, np.ones(4)])
    return floor, ConvexPiece("box", plate + np.array([2.0, 0.0, 0.0]))


def test_a_scanned_floor_is_moved_to_the_soles_by_at_most_30_mm_and_says_so() -> None:
    soles = {foot: sole_corners(atlas(), atlas().postures["stand"], foot) for foot in FEET}
    (floor, box), notes = move_floor_to_soles(_seen(0.02), soles)
    assert np.abs(find_ground_gaps(np.vstack(list(soles.values())), (floor,))).max() < 1e-6
    assert np.array_equal(box.vertices, _seen(0.02)[1].vertices)
    assert re.fullmatch(r"the scanned floor was moved down by 20\.0 mm to the soles of .*; at most 30 mm", notes[0])
    for height in (0.0, 0.0029, -0.0029, 0.031, -0.031):
        pieces, notes = move_floor_to_soles(_seen(height), soles)
        assert notes == ()
        assert np.array_equal(pieces[0].vertices, _seen(height)[0].vertices)


def test_a_floating_robot_that_lacks_masses_changes_no_contacts(tmp_path) -> None:
    text = dishonest.without_masses(atlas().source.urdf)
    (tmp_path / "atlas.urdf").write_text(text)
    meshes = next(iter(atlas().source.files.values())).parents[2]
    data = {**request(True), "start": {"base": {"position": [0, 0, 0.938]}}, "options": {"feet": list(FEET)}}
    data["robot"] = {"urdf": str(tmp_path / "atlas.urdf"), "root": "floating", "package_dirs": [str(meshes)]}
    notes = " ".join(prepare(parse_request(data)).notes)
    assert "the links of atlas have 0 kg in all: its balance and its torques are not checked" in notes
    del data["goal"]
    data["task"] = {
        "valve": {
            "centre": [0.6, 0.0, 1.2],
            "axis": [1, 0, 0],
            "radius": 0.15,
            "spokes_deg": [45, 135, 225, 315],
            "turn_deg": 30,
        }
    }
    with pytest.raises(RequestError, match="the links of atlas have 0 kg in all, and this task keeps the balance"):
        prepare(parse_request(data))


@pytest.mark.parametrize(
    ("value", "key", "words"),
    [(-0.1, "ixx", "inertia ixx is -0.1"), (0.5, "ixy", "none may be negative: ixy, ixz or iyz is too large")],
)
def test_a_negative_inertia_is_refused_in_one_line(tmp_path, value: float, key: str, words: str) -> None:
    (tmp_path / "robot.urdf").write_text(dishonest.with_inertia(dishonest.arm(), value, key))
    with pytest.raises(RobotError, match=words):
        load_robot(urdf=tmp_path / "robot.urdf")


def test_what_the_request_does_not_waive_must_be_checked() -> None:
    motion = standing().motion
    untimed = verify(replace(motion, law=None))
    assert untimed.status is Status.FEASIBLE_AT_SAMPLES
    assert "coverage.missing.limits.speed" in {check.name for check in untimed.checks}
    assert verify(replace(motion, law=None, waived=frozenset({"timing"}))).status is Status.CERTIFIED
    unbalanced = verify(replace(motion, phases=tuple(replace(phase, support=None) for phase in motion.phases)))
    assert unbalanced.status is Status.FEASIBLE_AT_SAMPLES
    names = {check.name for check in unbalanced.checks}
    assert {f"coverage.missing.{kind}.{motion.phases[0].name}" for kind in ("balance", "zmp")} <= names
    loose = verify(replace(motion, phases=tuple(replace(phase, contacts=()) for phase in motion.phases)))
    assert loose.status is not Status.CERTIFIED
