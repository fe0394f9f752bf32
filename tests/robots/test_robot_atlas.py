"""The bundled Atlas: its figures, its soles, its hooks and its postures."""

from __future__ import annotations

import csv
from itertools import combinations
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest
from lxml import etree
from scipy.spatial import ConvexHull

from costs.robot import RobotError, RobotModel, load_robot
from costs.robot.atlas.description import FOLDER
from costs.robot.atlas.generate import generate
from costs.robot.self_pairs import convex, sort_pair

URDF = etree.fromstring((FOLDER / "atlas.urdf").read_bytes())


@pytest.fixture(scope="module")
def atlas() -> RobotModel:
    return load_robot("atlas")


def _rows(shared_data: Path, name: str) -> list[dict[str, str]]:
    with (shared_data / "atlas_v5" / name).open(newline="") as stream:
        return list(csv.DictReader(stream))


def _floats(text: str) -> list[float]:
    return [float(word) for word in text.split()]


def _placements(robot: RobotModel, q: np.ndarray) -> pin.Data:
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return data


def _frame(robot: RobotModel, data: pin.Data, name: str) -> pin.SE3:
    return data.oMf[int(robot.model.getFrameId(name))]


def _configuration(robot: RobotModel, base: np.ndarray | None = None, **angles: float) -> np.ndarray:
    """A pose from a named one, ``arm_shx=...`` set on the left and mirrored on the right."""
    q = np.zeros(robot.n) if base is None else base.copy()
    for name, angle in angles.items():
        mirrored = name.rpartition("_")[2] in {"shz", "shx", "elx", "wrx", "hpz", "hpx", "akx"}
        q[robot.joint_names.index(f"l_{name}")] = angle
        q[robot.joint_names.index(f"r_{name}")] = -angle if mirrored else angle
    return q


def _clearances(robot: RobotModel, q: np.ndarray) -> dict[tuple[str, str], float]:
    """Signed distance of every pair that is checked."""
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    placed = []
    for body in robot.bodies:
        pose = data.oMi[body.joint]
        placed.append((convex(body.vertices), coal.Transform3s(pose.rotation, pose.translation)))
    found: dict[tuple[str, str], float] = {}
    for i, j in combinations(range(len(placed)), 2):
        pair = sort_pair(robot.bodies[i].link, robot.bodies[j].link)
        if pair[0] != pair[1] and pair not in robot.ignored_pairs:
            distance = coal.distance(*placed[i], *placed[j], coal.DistanceRequest(), coal.DistanceResult())
            found[pair] = min(distance, found.get(pair, np.inf))
    return found


def test_every_joint_figure_is_the_tables(shared_data: Path) -> None:
    joints = {element.get("name"): element for element in URDF.findall("joint")}
    rows = _rows(shared_data, "joints.csv")
    assert len(rows) == 37
    for row in rows:
        element = joints.pop(row["joint"])
        assert element.find("parent").get("link") == row["parent"]
        assert element.find("child").get("link") == row["child"]
        assert _floats(element.find("origin").get("xyz")) == [float(row[key]) for key in "xyz"]
        assert _floats(element.find("origin").get("rpy")) == [float(row[key]) for key in ("roll", "pitch", "yaw")]
        if row["type"] != "revolute":
            assert element.get("type") == "fixed"  # the spinning lidar too
            continue
        assert element.get("type") == "revolute"
        assert _floats(element.find("axis").get("xyz")) == [float(row[key]) for key in ("ax", "ay", "az")]
        for key in ("lower", "upper", "velocity", "effort"):
            assert float(element.find("limit").get(key)) == float(row[key]), (row["joint"], key)
        for key in ("damping", "friction"):
            assert float(element.find("dynamics").get(key)) == float(row[key])
    own = ("hook", "peg", "stub", "tool")
    assert sorted(joints) == [f"{side}_{part}_joint" for side in "lr" for part in own]


def test_every_link_figure_is_the_tables(shared_data: Path) -> None:
    links = {element.get("name"): element for element in URDF.findall("link")}
    for row in _rows(shared_data, "links.csv"):
        inertial = links.pop(row["link"]).find("inertial")
        if not row["mass"]:
            assert inertial is None
            continue
        assert float(inertial.find("mass").get("value")) == float(row["mass"])
        origin = inertial.find("origin")
        assert _floats(origin.get("xyz")) == [float(row[f"com_{key}"]) for key in "xyz"]
        assert _floats(origin.get("rpy")) == [float(row[f"com_{key}"]) for key in ("roll", "pitch", "yaw")]
        for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"):
            assert float(inertial.find("inertia").get(key)) == float(row[key]), (row["link"], key)
    assert sorted(links) == [f"{side}_{part}" for side in "lr" for part in ("hook", "peg", "stub", "tool")]
    assert all(links[name].find("inertial") is None for name in links)


def test_soles_are_the_lowest_face_of_the_feet(shared_data: Path, atlas: RobotModel) -> None:
    for foot in ("l_foot", "r_foot"):
        rows = [r for r in _rows(shared_data, "foot_sole.csv") if r["link"] == foot and "unplugged" in r["source"]]
        sole = {tuple(float(row[key]) for key in "xyz") for row in rows}
        (body,) = (body for body in atlas.bodies if body.link == foot)
        lowest = body.vertices[body.vertices[:, 2] < body.vertices[:, 2].min() + 1e-3]
        assert {tuple(corner) for corner in np.round(lowest, 9)} == sole
        assert len(sole) == 4


def test_has_36_coordinates_base_first(atlas: RobotModel) -> None:
    assert atlas.n == atlas.model.nq == atlas.model.nv == 36
    assert atlas.joint_names[:6] == ("base_x", "base_y", "base_z", "base_yaw", "base_pitch", "base_roll")
    assert np.all(np.isinf(atlas.lower[:6]))
    assert np.all(np.isinf(atlas.upper[:6]))
    assert np.all(np.isfinite(atlas.lower[6:]))
    assert np.all(atlas.acceleration[6:] == 10.0)


def test_weighs_158_6_kg(atlas: RobotModel) -> None:
    assert pin.computeTotalMass(atlas.model) == pytest.approx(158.560494, abs=1e-6)


def test_foot_frame_hangs_0_862_m_below_the_pelvis_at_zero(atlas: RobotModel) -> None:
    data = _placements(atlas, np.zeros(atlas.n))
    drop = _frame(atlas, data, "pelvis").translation - _frame(atlas, data, "l_foot").translation
    np.testing.assert_allclose(drop, [0.0, -0.1115, 0.862], atol=1e-12)


def test_files_are_what_the_generator_writes() -> None:
    written = {path.relative_to(FOLDER).as_posix(): path.read_text(encoding="utf-8")
               for path in FOLDER.rglob("*") if path.suffix in (".urdf", ".srdf", ".obj")}  # fmt: skip
    generated = generate()
    assert sorted(written) == sorted(generated)
    assert [name for name in generated if generated[name] != written[name]] == []


def test_bodies_have_at_most_32_vertices_and_a_mirror_image(atlas: RobotModel) -> None:
    bodies = {body.name: body for body in atlas.bodies}
    assert all(len(body.vertices) <= 32 and body.outer is body.vertices for body in atlas.bodies)
    for name, body in bodies.items():
        if name.startswith("l_") and not name.endswith("hook"):
            mirrored = body.vertices * [1.0, -1.0, 1.0]
            other = bodies["r_" + name[2:]].vertices
            assert {tuple(v) for v in np.round(mirrored, 6) + 0.0} == {tuple(v) for v in np.round(other, 6) + 0.0}


@pytest.mark.parametrize("distance", [0.12, 0.25])
def test_tool_frame_ends_the_hook_on_the_hand_axis(distance: float) -> None:
    robot = load_robot("atlas", tool_distance_m=distance)
    rng = np.random.default_rng(5)
    q = np.clip(rng.uniform(-1.0, 1.0, robot.n), robot.lower, robot.upper)
    data = _placements(robot, q)
    for side, sign in (("l", 1.0), ("r", -1.0)):
        hand, tool = _frame(robot, data, f"{side}_hand"), _frame(robot, data, f"{side}_tool")
        pose_hand_tool = hand.actInv(tool)
        np.testing.assert_allclose(pose_hand_tool.translation, [0.0, sign * distance, 0.0], atol=1e-12)
        np.testing.assert_allclose(pose_hand_tool.rotation[:, 2], [0.0, sign, 0.0], atol=1e-12)
        np.testing.assert_allclose(pose_hand_tool.rotation[:, 0], [1.0, 0.0, 0.0], atol=1e-12)
        elbow = _frame(robot, data, f"{side}_larm").translation
        assert np.linalg.norm(tool.translation - elbow) > np.linalg.norm(hand.translation - elbow)
        (hook,) = (body for body in robot.bodies if body.link == f"{side}_hook")
        assert (sign * hook.vertices[:, 1]).max() == pytest.approx(distance)
        assert (sign * hook.vertices[:, 1]).min() == pytest.approx(0.045)
        radius = np.linalg.norm(hook.vertices[:, [0, 2]], axis=1).max()
        assert 0.008 < radius < 0.010


@pytest.mark.parametrize("distance", [0.0, 0.05, 2.0, float("nan")])
def test_tool_distance_out_of_range_is_refused(distance: float) -> None:
    with pytest.raises(RobotError, match="tool_distance_m"):
        load_robot("atlas", tool_distance_m=distance)


@pytest.mark.parametrize("posture", ["stand", "reach_ready"])
def test_postures_stand_level_with_the_weight_over_the_feet(atlas: RobotModel, posture: str) -> None:
    q = atlas.postures[posture]
    assert np.all(q >= atlas.lower)
    assert np.all(q <= atlas.upper)
    assert np.all(q[[0, 1, 3, 4, 5]] == 0.0)
    data = _placements(atlas, q)
    corners = []
    for foot in ("l_foot", "r_foot"):
        (body,) = (body for body in atlas.bodies if body.link == foot)
        pose = data.oMi[body.joint]
        world = body.vertices @ pose.rotation.T + pose.translation
        sole = world[body.vertices[:, 2] < body.vertices[:, 2].min() + 1e-6]
        np.testing.assert_allclose(sole[:, 2], 0.0, atol=1e-8)
        corners.append(sole[:, :2])
    feet = np.vstack(corners)
    middle = 0.5 * (feet.min(axis=0) + feet.max(axis=0))
    com = pin.centerOfMass(atlas.model, data, q)
    assert np.linalg.norm(com[:2] - middle) < 0.01
    hull = ConvexHull(feet)
    assert (hull.equations[:, :2] @ com[:2] + hull.equations[:, 2]).max() < -0.1


def test_standing_arms_hang_clear_of_the_body(atlas: RobotModel) -> None:
    clearances = _clearances(atlas, atlas.postures["stand"])
    assert min(clearances.values()) > 0.03
    arm = ("scap", "uarm", "larm", "ufarm", "lfarm", "hand", "hook")
    to_body = [distance for (a, b), distance in clearances.items()
               if a[2:] in arm and b in ("utorso", "pelvis", "mtorso", "l_uleg", "r_uleg")]  # fmt: skip
    assert to_body
    assert min(to_body) > 0.03


def test_ready_hands_are_20_cm_in_front_of_the_torso(atlas: RobotModel) -> None:
    clearances = _clearances(atlas, atlas.postures["reach_ready"])
    assert min(clearances.values()) > 0.03
    for side in ("l", "r"):
        assert clearances[sort_pair(f"{side}_hand", "utorso")] > 0.2
    data = _placements(atlas, atlas.postures["reach_ready"])
    tool = _frame(atlas, data, "l_tool")
    assert tool.translation[0] > 0.5
    assert tool.rotation[0, 2] > 0.9  # the hook points ahead


WORKING_POSES = {
    "zero": {},
    "squat": {"leg_hpy": -1.3, "leg_kny": 2.0, "leg_aky": -0.7, "arm_shx": -1.2, "arm_elx": 0.5, "arm_ely": 1.6},
    "reach_forward": {"arm_shz": -1.2, "arm_shx": -0.1, "arm_ely": 1.6, "arm_elx": 0.2},
    "arms_up": {"arm_shx": 1.3, "arm_ely": 1.6, "arm_elx": 0.3},
    "hang": {"arm_shx": -1.35},
    "legs_wide": {"leg_hpx": 0.5, "leg_akx": -0.5, "arm_shx": -1.0},
    "step": {"leg_hpy": -0.9, "leg_kny": 1.2, "leg_aky": -0.3, "arm_shx": -1.2},
}


@pytest.mark.parametrize("pose", WORKING_POSES)
def test_links_stay_apart_over_the_working_range(atlas: RobotModel, pose: str) -> None:
    clearances = _clearances(atlas, _configuration(atlas, **WORKING_POSES[pose]))
    closest = min(clearances, key=lambda pair: clearances[pair])
    assert clearances[closest] > 0.005, closest


def test_unknown_names_get_a_suggestion() -> None:
    with pytest.raises(RobotError, match="unknown robot 'atls'; expected atlas"):
        load_robot("atls")


def test_groups_are_in_the_order_of_the_coordinates(atlas: RobotModel) -> None:
    assert atlas.link_groups["feet"] == ("l_foot", "r_foot")
    assert atlas.link_groups["hands"] == ("l_hand", "r_hand")
    assert len(atlas.groups["whole_body"]) == 30
    assert atlas.groups["left_arm"] == tuple(n for n in atlas.joint_names if n.startswith("l_arm"))
    assert atlas.groups["back"] == ("back_bkz", "back_bky", "back_bkx")
    assert not atlas.fixed_links
    assert not atlas.mechanism_links


def test_meshes_are_closed_surfaces_that_face_outwards() -> None:
    paths = sorted((FOLDER / "meshes").glob("*.obj"))
    assert len(paths) == 33
    for path in paths:
        lines = [line.split() for line in path.read_text().splitlines()]
        points = np.array([[float(word) for word in words[1:]] for words in lines if words[0] == "v"])
        faces = [[int(word) - 1 for word in words[1:]] for words in lines if words[0] == "f"]
        edges = [(face[k - 1], face[k]) for face in faces for k in range(len(face))]
        # Every edge is passed once each way.
        assert len(edges) == len(set(edges))
        assert {(b, a) for a, b in edges} == set(edges)
        for face in faces:
            a, b, c = points[face[:3]]
            assert np.cross(b - a, c - b) @ (points[face].mean(axis=0) - points.mean(axis=0)) > 0.0, path.name
