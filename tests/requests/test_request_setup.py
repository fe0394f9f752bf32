"""A request against its robot and scene: names, limits, files, a start that cannot be."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

import perception
from costs.robot import RobotModel, load_robot
from costs.scene import Scene
from service.demands.scene import make_floor
from service.errors import RequestError
from service.planner import plan
from service.replay.replay import verify_result
from service.request.file import parse_request
from service.result.motion_json import file_positions
from service.result.output import write_result
from service.setup.prepare import PlanSetup, prepare
from service.setup.world import build_obstacles
from service.start.configuration import make_start_configuration
from service.start.overlaps import describe_collisions
from service.start.standing import find_standing_problems, sole_corners

GOAL = {"posture": "stand"}
BOX = {"type": "box", "size": [0.3, 0.3, 0.3]}
BEAM = {"name": "beam", "link": "l_hand", "type": "box", "size": [0.1, 0.1, 0.1], "position": [0.0, 0.2, 0.0]}
KEEP = {"link": "r_tool", "relative_to": "l_tool"}


@pytest.fixture(scope="module")
def atlas() -> RobotModel:
    return load_robot("atlas")


def _prepare(folder: Path | str = ".", **sections: Any) -> PlanSetup:
    return prepare(parse_request({"robot": {"name": "atlas"}, "goal": GOAL, **sections}, folder))


def _problems(folder: Path | str = ".", **sections: Any) -> list[str]:
    with pytest.raises(RequestError) as caught:
        _prepare(folder, **sections)
    return list(caught.value.problems)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({}, "attached 'beam': that l_hand holds it is assumed; its grip is not proven"),
        (
            {"touches": ["l_hook"]},
            "attached 'beam': that l_hand and l_hook hold it is assumed; their grip is not proven",
        ),
    ],
)
def test_the_grip_of_a_carried_body_is_named_as_assumed(more: dict[str, Any], words: str) -> None:
    assert words in _prepare(attached=[BEAM | more]).notes


def test_atlas_stands_on_the_floor_by_default() -> None:
    setup = _prepare()
    assert setup.contacts == ("l_foot", "r_foot")
    assert [piece.name for piece in setup.scene.pieces] == ["floor"]
    assert setup.notes == ()
    for corners in setup.soles.values():
        assert len(corners) == 4
        np.testing.assert_allclose(corners[:, 2], 0.0, atol=1e-6)


def test_joints_override_the_posture_by_either_spelling() -> None:
    setup = _prepare(
        start={"posture": "stand", "joints": {"neck_ry": 0.1}, "joint_names": ["back_bkz"], "positions": [0.2]}
    )
    names = setup.robot.joint_names
    assert setup.start[names.index("neck_ry")] == 0.1
    assert setup.start[names.index("back_bkz")] == 0.2
    assert setup.start[names.index("l_arm_elx")] == setup.robot.postures["stand"][names.index("l_arm_elx")]


def test_a_start_base_is_where_the_pelvis_is(atlas: RobotModel) -> None:
    # Feet wherever the tilted pelvis takes them: only the coordinates are looked at.
    pose = Rotation.from_euler("z", 0.7) * Rotation.from_euler("y", 0.3) * Rotation.from_euler("x", -0.2)
    base = {"position": [1.0, 2.0, 3.0], "quaternion_wxyz": pose.as_quat(scalar_first=True).tolist()}
    request = parse_request({"robot": {"name": "atlas"}, "goal": GOAL, "start": {"base": base}})
    q, notes = make_start_configuration(atlas, request.start)
    np.testing.assert_allclose(q[:6], [1.0, 2.0, 3.0, 0.7, 0.3, -0.2], atol=1e-9)
    assert notes == ()
    np.testing.assert_allclose(file_positions(atlas, q[None])[0, 3:7], base["quaternion_wxyz"], atol=1e-9)


def test_a_pitch_near_90_degrees_is_refused(atlas: RobotModel) -> None:
    half = np.sqrt(0.5)
    base = {"position": [0.0, 0.0, 1.0], "quaternion_wxyz": [half, 0.0, half, 0.0]}
    (line,) = _problems(start={"base": base})
    assert line == "start.base.quaternion_wxyz: a pitch of 90 deg is too near to 90; expected at most 85"


@pytest.mark.parametrize(
    ("sections", "problem"),
    [
        (
            {"start": {"joints": {"l_arm_elz": 0.1}}},
            "unknown joint 'l_arm_elz' in start.joints; atlas has l_arm_ely, l_arm_elx, r_arm_ely, …",
        ),
        ({"goal": {"joints": {"elbow": 0.1}}}, "unknown joint 'elbow' in goal.joints; atlas has "),
        ({"start": {"posture": "stnd"}}, "unknown posture 'stnd' in start.posture; atlas has stand, reach_ready"),
        ({"goal": {"posture": "sit"}}, "unknown posture 'sit' in goal.posture; atlas has stand, reach_ready"),
        (
            {"goal": {"poses": [{"link": "l_hnad", "position": [0, 0, 0]}]}},
            "unknown link 'l_hnad' in goal.poses[0].link; atlas has l_hand, ",
        ),
        ({"keep": [{"link": "l_hnad"}]}, "unknown link 'l_hnad' in keep[0].link; atlas has l_hand, "),
        (
            {"keep": [{"link": "l_hand", "relative_to": "r_hnad"}]},
            "unknown link 'r_hnad' in keep[0].relative_to; atlas has r_hand, ",
        ),
        ({"keep": [{"link": "l_hand", "relative_to": "l_hook"}]}, "keep[0]: no joint moves l_hand relative to l_hook"),
        ({"attached": [BEAM | {"link": "l_hnad"}]}, "unknown link 'l_hnad' in attached[0].link; atlas has l_hand, "),
        (
            {"attached": [BEAM | {"touches": ["hook"]}]},
            "unknown link 'hook' in attached[0].touches; atlas has r_hook, ",
        ),
        (
            {"attached": [BEAM | {"name": "pelvis"}]},
            "attached[0].name: 'pelvis' is a link of atlas; expected another name",
        ),
        ({"attached": [BEAM, BEAM]}, "attached[1].name: 'beam' is given twice; expected another name"),
        (
            {"attached": [BEAM | {"touches": ["r_hand"]}]},
            "attached[0].touches: r_hand may move against l_hand; expected keep: [{link: r_hand, relative_to: l_hand}]",
        ),
        (
            {"attached": [BEAM | {"touches": ["r_hand"]}], "keep": [KEEP | {"free_axis": "y"}]},
            "attached[0].touches: r_hand may move against l_hand; ",
        ),
        ({"options": {"feet": []}}, "options.feet: lists no link"),
        ({"options": {"feet": ["l_fot"]}}, "unknown link 'l_fot' in options.feet; atlas has l_foot, "),
        ({"robot": {"name": "atlsa"}}, "robot.name: unknown robot 'atlsa'; "),
        (
            {"robot": {"urdf": "missing.urdf"}},
            "robot.urdf: missing.urdf is not there; paths start at the ",
        ),
        ({"scene": {"cloud": "missing.pcd"}}, "scene.cloud: missing.pcd: cannot be read"),
        ({"start": {"joints": {"base_x": 0.1}}}, "unknown joint 'base_x' in start.joints"),
    ],
)
def test_an_unknown_name_is_told_with_the_names_that_would_do(sections: dict[str, Any], problem: str) -> None:
    (line,) = _problems(**sections)
    assert line.startswith(problem)


def test_a_start_just_beyond_a_limit_is_snapped_and_said(atlas: RobotModel) -> None:
    limit = float(atlas.upper[atlas.joint_names.index("neck_ry")])
    setup = _prepare(start={"joints": {"neck_ry": limit + 5e-4}})
    assert setup.start[atlas.joint_names.index("neck_ry")] == limit
    (note,) = setup.notes
    assert note.startswith("start: neck_ry snapped from ")


def test_a_start_far_beyond_a_limit_is_refused_with_the_limits(atlas: RobotModel) -> None:
    limit = float(atlas.upper[atlas.joint_names.index("neck_ry")])
    (line,) = _problems(start={"joints": {"neck_ry": limit + 2e-3}})
    assert line.startswith("start.joints.neck_ry: ")
    assert line.endswith(f" to {limit:.6g}")


def test_a_goal_beyond_a_limit_is_refused() -> None:
    (line,) = _problems(goal={"joints": {"neck_ry": 9.0}})
    assert line.startswith("goal.joints.neck_ry: 9 is outside the joint's limits; ")


def test_a_start_in_collision_names_pair_and_depth() -> None:
    # The pelvis of the standing Atlas is at (0, 0, 0.9); a box in it.
    lines = _problems(scene={"obstacles": [{"name": "crate", "position": [0.0, 0.0, 0.9], **BOX}]})
    assert any(line.startswith("start is in collision: pelvis is ") and "mm inside crate" in line for line in lines)
    links = [line.split()[4] for line in lines]
    assert len(set(links)) == len(links)  # a link of several bodies is named once


def test_depth_of_a_start_in_collision_is_the_penetration(atlas: RobotModel) -> None:
    # A floor 50 mm too high: both feet stand 50 mm deep in it.
    q = atlas.postures["stand"]
    lines = describe_collisions(atlas, q, Scene((make_floor(0.05, q[:2]),)), ("l_foot", "r_foot"))
    assert {line.split(" is ")[0] for line in lines} == {"l_foot", "r_foot"}
    assert all("is 50 mm inside floor" in line for line in lines)


def test_crossed_legs_are_in_collision() -> None:
    lines = _problems(start={"joints": {"l_leg_hpx": -0.5}})
    assert lines[0].startswith("start is in collision: l_lleg is 1")
    assert lines[0].endswith(" mm inside r_uleg")


def test_a_centre_of_mass_beyond_the_feet_is_told_in_metres(atlas: RobotModel) -> None:
    q = atlas.postures["stand"]
    soles = {"l_foot": sole_corners(atlas, q, "l_foot")}
    (line,) = find_standing_problems(atlas, q, soles, [])
    inner_edge = float(soles["l_foot"][:, 1].min())
    outside = float(line.split(" m outside")[0].split()[-1])
    assert outside == pytest.approx(inner_edge, abs=0.02)  # the COM is in the middle between the feet
    assert "outside the support polygon of l_foot" in line


def test_one_planted_foot_under_a_middle_stance_is_refused() -> None:
    lines = _problems(options={"feet": ["l_foot"]})
    assert any(line.startswith("start is out of balance: the centre of mass") for line in lines)


def test_feet_in_the_air_are_refused(atlas: RobotModel) -> None:
    height = float(atlas.postures["stand"][2]) + 0.1
    lines = _problems(start={"base": {"position": [0, 0, height]}})
    assert "start is out of balance: the ground is 100.0 mm below the sole of l_foot; expected at most 3 mm" in lines[0]


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"", "is empty"),
        (b"# .PCD v0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 2000000000\nHEIGHT 1\n"
         b"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2000000000\nDATA binary\n", ""),
        (b"not a cloud at all", ""),
    ],
)  # fmt: skip
def test_a_lying_cloud_is_refused_by_its_field(tmp_path: Path, content: bytes, problem: str) -> None:
    (tmp_path / "scan.pcd").write_bytes(content)
    (line,) = _problems(tmp_path, scene={"cloud": "scan.pcd"})
    assert line.startswith("scene.cloud: ")
    assert problem in line


def test_several_clouds_are_read_with_their_poses_and_unit(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = {}

    def read_clouds(files: object, **options: object) -> None:
        asked.update(options, files=files)
        raise perception.CloudError("enough")

    monkeypatch.setattr(perception, "read_clouds", read_clouds)
    cloud = [{"file": "a.pcd"}, {"file": "/scans/b.e57", "position": [1, 2, 3]}]
    options = {"unit": "mm", "apply_viewpoint": True, "sensor": (0.0, 0.0, 1.6), "topic": "/points", "message": "all"}
    (line,) = _problems(scene={"cloud": cloud, **options})
    assert line == "scene.cloud: enough"
    files = [(Path("a.pcd"), None), (Path("/scans/b.e57"), (1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0))]
    sensor = {"level": False, "sensor_model": "auto", "sensor_sigma": 0.0}
    assert asked == {"files": files, **options, **sensor}


def test_round_obstacles_are_contained_in_their_pieces() -> None:
    rng = np.random.default_rng(0)
    request = parse_request({
        "robot": {"name": "atlas"},
        "goal": GOAL,
        "scene": {"obstacles": [
            {"name": "ball", "type": "sphere", "radius": 0.2, "position": [1, 2, 3]},
            {"name": "post", "type": "cylinder", "radius": 0.1, "height": 1.0},
            {"name": "pill", "type": "capsule", "radius": 0.1, "height": 1.0},
        ]},
    })  # fmt: skip
    pieces = {piece.name: ConvexHull(piece.vertices).equations for piece in build_obstacles(request)[0]}
    directions = rng.normal(size=(500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    ring = directions[:, :2] / np.linalg.norm(directions[:, :2], axis=1, keepdims=True)
    surfaces = {
        "ball": [1, 2, 3] + 0.2 * directions,
        "post": np.column_stack([0.1 * ring, rng.uniform(-0.5, 0.5, 500)]),
        "pill": 0.1 * directions + np.column_stack([np.zeros((500, 2)), 0.5 * np.sign(directions[:, 2])]),
    }
    for name, points in surfaces.items():
        equations = pieces[name]
        assert np.max(points @ equations[:, :3].T + equations[:, 3]) <= 1e-9


def test_an_obstacle_turns_about_its_own_position() -> None:
    turned = {"position": [5, 0, 1], "quaternion_wxyz": [np.cos(0.25), 0, 0, np.sin(0.25)]}  # 0.5 rad about z
    plank = {"name": "plank", "type": "box", "size": [2.0, 0.2, 0.1], **turned}
    request = parse_request({"robot": {"name": "atlas"}, "goal": GOAL, "scene": {"obstacles": [plank]}})
    ((piece,), _) = build_obstacles(request)
    corner = [5 + np.cos(0.5) - 0.1 * np.sin(0.5), np.sin(0.5) + 0.1 * np.cos(0.5), 1.05]
    assert np.linalg.norm(piece.vertices - corner, axis=1).min() < 1e-12


def test_flat_points_are_no_obstacle() -> None:
    flat = {"name": "sheet", "type": "convex", "points": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]}
    (line,) = _problems(scene={"obstacles": [flat]})
    assert line == "scene.obstacles[0].points: the 4 points lie in a plane; expected four that span a volume"


def test_an_obstacle_may_not_take_the_floors_name() -> None:
    (line,) = _problems(scene={"obstacles": [{"name": "floor", "position": [3, 0, 1], **BOX}]})
    assert line.startswith("scene.obstacles: piece names must be unique; repeated: floor")


def test_a_fixed_robot_has_no_feet_and_no_floor_by_default(shared_data: Path) -> None:
    folder = shared_data / "robots"
    urdf = sorted(folder.glob("panda*/*.urdf"))[0].relative_to(folder)
    robot = {"urdf": str(urdf), "package_dirs": [str(urdf.parent)]}
    request = {
        "robot": robot,
        "goal": {"joints": {"panda_joint1": 0.5}},
        "start": {"joints": {"panda_joint4": -1.5, "panda_joint6": 1.5}},
    }
    setup = prepare(parse_request(request, folder))
    assert setup.contacts == ()
    assert setup.scene.pieces == ()
    with pytest.raises(RequestError, match=r"options\.feet: this robot's base is fixed"):
        prepare(parse_request({**request, "options": {"feet": ["panda_link0"]}}, folder))


def test_what_is_attached_is_a_link_that_goals_and_what_is_kept_may_name() -> None:
    attached = BEAM | {"touches": ["r_hand", "l_hook"], "mass_kg": 2.0}
    setup = _prepare(start={"posture": "reach_ready"}, attached=[attached], keep=[KEEP], goal={"poses": [GOAL_OF_BEAM]})
    assert setup.robot.model.existFrame("beam")
    assert ("beam", "r_hand") in setup.robot.ignored_pairs
    assert ("beam", "l_lfarm") not in setup.robot.ignored_pairs


GOAL_OF_BEAM = {"link": "beam", "position": [0.5, 0.0, 1.2]}


def _post(folder: Path, inertial: str) -> Path:
    """A post with an arm on a foot."""
    links = "".join(
        f'<link name="{name}">{inertial}<collision><origin xyz="0 0 {z}"/><geometry><box size="{size}"/></geometry>'
        "</collision></link>"
        for name, z, size in (("foot", 0.05, "0.4 0.4 0.1"), ("post", 0.3, "0.1 0.1 0.5"))
    )
    joint = (
        '<joint name="turn" type="revolute"><parent link="foot"/><child link="post"/><origin xyz="0 0 0.12"/>'
        '<axis xyz="0 0 1"/><limit lower="-2" upper="2" velocity="1" effort="100"/></joint>'
    )
    path = folder / "post.urdf"
    path.write_text(f'<robot name="stele">{links}{joint}</robot>')
    return path


NO_MASS = '<inertial><mass value="0"/><inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial>'


@pytest.mark.parametrize("inertial", ["", NO_MASS])
def test_a_robot_on_feet_that_weighs_nothing_is_planned_without_balance(tmp_path: Path, inertial: str) -> None:
    asked = {"robot": {"urdf": str(_post(tmp_path, inertial)), "root": "floating"}, "goal": {"joints": {"turn": 0.5}}}
    request = parse_request({**asked, "options": {"feet": ["foot"]}, "scene": {"floor": 0.0}}, folder=tmp_path)
    result = plan(request)
    assert result.verdict.value == "CERTIFIED", result.explanation
    assert "the links of stele have 0 kg in all: its balance and its torques are not checked" in " ".join(result.notes)
    assert result.certificate is not None
    assert result.certificate.coverage.not_checked == ("torques (no link names a mass)", "balance in 'reach'")
    assert not any(check.name.startswith("balance") for check in result.certificate.checks)
    write_result(result, tmp_path / "out")
    assert verify_result(tmp_path / "out")["verdict"] == "CERTIFIED"


def test_a_robot_that_is_bolted_down_needs_no_masses(tmp_path: Path) -> None:
    robot = {"urdf": str(_post(tmp_path, "")), "root": "fixed"}
    assert not _prepare(tmp_path, robot=robot, goal={"joints": {"turn": 0.5}}).robot.is_floating


def test_a_load_that_a_standing_robot_cannot_hold_is_refused_with_the_joint() -> None:
    """25 kg 0.4 m before the right hand: the wrist bears 35 N m of its 25 (own statics), the legs are not judged."""
    load = {"name": "load", "type": "box", "link": "r_hand", "size": [0.2, 0.2, 0.2], "position": [0, -0.40, 0]}
    held = [{**load, "mass_kg": 25, "touches": ["r_hook"]}]
    lines = _problems(start={"posture": "stand"}, attached=held)
    assert [line for line in lines if line.startswith("start: r_arm_wrx needs 35.3") and "N m" in line]
    _prepare(start={"posture": "stand"}, attached=[{**held[0], "mass_kg": 10}])


def test_a_goal_that_a_fixed_robot_cannot_hold_is_refused(tmp_path: Path) -> None:
    """A link of 10 kg, its centre 0.5 m out: 49 N m when level, 0 when upright, of 30."""
    (tmp_path / "arm.urdf").write_text(
        '<robot name="arm"><link name="base"/><link name="bar"><inertial><origin xyz="0 0 0.5"/><mass value="10"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
        '<collision><origin xyz="0 0 0.5"/><geometry><box size="0.1 0.1 1"/></geometry></collision></link>'
        '<joint name="lift" type="revolute"><parent link="base"/><child link="bar"/><axis xyz="0 1 0"/>'
        '<limit lower="-2" upper="2" velocity="1" effort="30"/></joint></robot>'
    )
    arm = {"robot": {"urdf": "arm.urdf"}, "scene": {"floor": False}, "start": {"joints": {"lift": 0.0}}}
    with pytest.raises(RequestError, match=r"^goal: lift needs 49\.05 N m at rest, its effort limit is 30 N m"):
        prepare(parse_request({**arm, "goal": {"joints": {"lift": np.pi / 2}}}, tmp_path))
    prepare(parse_request({**arm, "goal": {"joints": {"lift": 0.3}}}, tmp_path))
