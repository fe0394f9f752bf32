"""Loading robots from strangers' URDF and SRDF files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from robot_files import CUBE_OBJ, LIMIT, joint, link, robot, two_links, write_urdf

from costs.robot import RobotError, RobotModel, bundled_robots, load_robot


@pytest.fixture
def panda(shared_data: Path) -> RobotModel:
    folder = shared_data / "mbm_panda"
    files = folder / "panda_bench"
    return load_robot(urdf=files / "panda.urdf", srdf=files / "panda.srdf", package_dirs=[folder])


def test_panda_loads_with_its_groups_states_and_pairs(panda: RobotModel) -> None:
    assert panda.joint_names == tuple(f"panda_joint{k}" for k in range(1, 8))
    assert not panda.is_floating
    np.testing.assert_allclose(panda.upper[:2], [2.9671, 1.8326])
    np.testing.assert_allclose(panda.velocity[[0, 6]], [2.3925, 2.8710])
    np.testing.assert_allclose(panda.acceleration, 10.0)
    assert panda.groups["panda_arm_hand"] == panda.joint_names
    assert panda.link_groups["hand"] == ("panda_hand", "panda_leftfinger", "panda_rightfinger")
    np.testing.assert_allclose(panda.postures["ready"], [0, -0.785, 0, -2.356, 0, 1.571, 0.785])
    # "open" names only locked fingers: the other joints are at 0, or at the limit next to it.
    np.testing.assert_allclose(panda.postures["open"], 0.0)
    assert ("panda_link1", "panda_link2") in panda.ignored_pairs
    assert ("panda_link0", "panda_link5") not in panda.ignored_pairs
    assert panda.fixed_links == {"panda_link0"}
    assert {body.joint for body in panda.bodies if body.link == "panda_link0"} == {0}


def test_relative_meshes_are_found_beside_the_urdf(shared_data: Path) -> None:
    robot_model = load_robot(urdf=shared_data / "robots" / "panda" / "panda.urdf")
    assert len(robot_model.bodies) == 11
    assert ("panda_link1", "panda_link2") in robot_model.ignored_pairs
    assert robot_model.source.files["meshes/hand.obj"].name == "hand.obj"


def test_drcsim_atlas_loads_on_a_floating_base(shared_data: Path) -> None:
    path = shared_data / "robots" / "atlas_drcsim_v5_simple" / "atlas_drcsim_v5_simple.urdf"
    atlas = load_robot(urdf=path, root="floating")
    assert atlas.n == atlas.model.nv == 36
    assert pin.computeTotalMass(atlas.model) == pytest.approx(174.3, abs=0.05)
    assert len(atlas.bodies) == 102


def test_a_written_source_loads_as_the_same_robot(panda: RobotModel, tmp_path: Path) -> None:
    for name, path in panda.source.files.items():
        target = tmp_path / name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(path.read_bytes())
    (tmp_path / "robot.srdf").write_text(panda.source.srdf)
    again = load_robot(
        urdf=write_urdf(tmp_path, panda.source.urdf), srdf=tmp_path / "robot.srdf", package_dirs=[tmp_path]
    )
    assert again.joint_names == panda.joint_names
    assert again.ignored_pairs == panda.ignored_pairs
    for old, new in zip(panda.bodies, again.bodies, strict=True):
        assert old.name == new.name
        np.testing.assert_array_equal(old.vertices, new.vertices)


def test_floating_base_adds_and_integrates_alike() -> None:
    atlas = load_robot("atlas")
    rng = np.random.default_rng(0)
    q, step = rng.uniform(-0.5, 0.5, (2, atlas.n))
    np.testing.assert_allclose(pin.integrate(atlas.model, q, step), q + step, atol=1e-12)
    data = atlas.model.createData()
    pin.framesForwardKinematics(atlas.model, data, q)
    pelvis = data.oMf[int(atlas.model.getFrameId("pelvis"))]
    np.testing.assert_allclose(pelvis.translation, q[:3])
    yaw, pitch, roll = q[3:6]
    np.testing.assert_allclose(pelvis.rotation, pin.rpy.rpyToMatrix(roll, pitch, yaw), atol=1e-12)


def test_continuous_joint_is_an_unbounded_plain_angle(tmp_path: Path) -> None:
    text = two_links('<limit velocity="2" effort="3"/>', kind="continuous")
    wheel = load_robot(urdf=write_urdf(tmp_path, text))
    assert wheel.model.nq == wheel.model.nv == 1
    assert (wheel.lower[0], wheel.upper[0], wheel.velocity[0]) == (-np.inf, np.inf, 2.0)
    data = wheel.model.createData()
    pin.forwardKinematics(wheel.model, data, np.array([7.0]))
    np.testing.assert_allclose(data.oMi[1].rotation, pin.rpy.rpyToMatrix(0.0, 0.0, 7.0), atol=1e-12)


def test_prismatic_joint_slides_along_its_axis(tmp_path: Path) -> None:
    slide = load_robot(urdf=write_urdf(tmp_path, two_links(kind="prismatic")))
    data = slide.model.createData()
    pin.forwardKinematics(slide.model, data, np.array([0.3]))
    np.testing.assert_allclose(data.oMi[1].translation, [0.0, 0.0, 1.3])


def test_acceleration_of_the_urdf_replaces_the_default(tmp_path: Path) -> None:
    text = two_links('<limit lower="-1" upper="1" velocity="2" effort="3" acceleration="4"/>')
    assert load_robot(urdf=write_urdf(tmp_path, text)).acceleration[0] == 4.0


def test_locked_joint_is_fixed_where_it_was_locked(tmp_path: Path) -> None:
    text = robot(
        link("base"), link("a"), link("b", '<box size="1 1 1"/>'), joint("ja", "base", "a"), joint("jb", "a", "b")
    )
    path = write_urdf(tmp_path, text)
    free, locked = load_robot(urdf=path), load_robot(urdf=path, locked_joints={"jb": 0.4})
    assert locked.joint_names == ("ja",)
    poses = []
    for model, q in ((free, [0.2, 0.4]), (locked, [0.2])):
        data = model.model.createData()
        pin.framesForwardKinematics(model.model, data, np.array(q))
        poses.append(data.oMf[int(model.model.getFrameId("b"))].homogeneous)
    np.testing.assert_allclose(poses[0], poses[1], atol=1e-12)
    # What is written for a stranger is locked too.
    assert 'name="jb" type="fixed"' in locked.source.urdf


def test_follower_is_locked_with_the_joint_it_mimics(tmp_path: Path) -> None:
    mimic = LIMIT + '<mimic joint="ja" multiplier="-2" offset="0.1"/>'
    text = robot(
        link("base"), link("a"), link("b"), link("c"), joint("ja", "base", "a"),
        joint("jb", "base", "b", inside=mimic), joint("jc", "base", "c"),
    )  # fmt: skip
    path = write_urdf(tmp_path, text)
    locked = load_robot(urdf=path, locked_joints={"ja": 0.3})
    assert locked.joint_names == ("jc",)
    frame = locked.model.frames[int(locked.model.getFrameId("b"))]
    np.testing.assert_allclose(frame.placement.rotation, pin.rpy.rpyToMatrix(0.0, 0.0, -0.5), atol=1e-12)


def test_every_collision_element_is_a_body_in_its_joints_frame(tmp_path: Path) -> None:
    (tmp_path / "cube.obj").write_text(CUBE_OBJ)
    mesh = '<mesh filename="cube.obj" scale="2 2 2"/>'
    text = robot(
        link("base"), link("arm", '<sphere radius="0.1"/>', mesh), link("tip", '<box size="2 2 2"/>'),
        joint("turn", "base", "arm"), joint("weld", "arm", "tip", "fixed", "", "0 0 5"),
    )  # fmt: skip
    bodies = {body.name: body for body in load_robot(urdf=write_urdf(tmp_path, text)).bodies}
    assert list(bodies) == ["arm", "arm/1", "tip"]
    assert {body.joint for body in bodies.values()} == {1}
    np.testing.assert_allclose(bodies["arm/1"].vertices.max(axis=0), [2.0, 2.0, 2.0])
    np.testing.assert_allclose(bodies["tip"].vertices.min(axis=0), [-1.0, -1.0, 4.0])
    assert bodies["tip"].link == "tip"


def _srdf(folder: Path, body: str) -> Path:
    path = folder / "robot.srdf"
    path.write_text(f'<robot name="sample">{body}</robot>')
    return path


@pytest.fixture
def chain(tmp_path: Path) -> Path:
    """base -ja- a -jb- b -jc- c, and a tool welded to c."""
    tail = [
        joint("jc", "b", "c", inside=LIMIT.replace('lower="-1"', 'lower="0.5"')),
        joint("weld", "c", "tool", "fixed", ""),
    ]
    names = ("base", "a", "b", "c", "tool")
    return write_urdf(
        tmp_path, robot(*(link(n) for n in names), joint("ja", "base", "a"), joint("jb", "a", "b"), *tail)
    )


def test_groups_by_joint_link_chain_and_subgroup(chain: Path) -> None:
    srdf = _srdf(
        chain.parent,
        '<group name="all"><group name="upper"/><group name="end"/></group>'
        '<group name="upper"><chain base_link="base" tip_link="b"/></group>'
        '<group name="end"><link name="c"/><link name="tool"/></group>'
        '<group name="one"><joint name="jb"/><joint name="weld"/></group>',
    )
    model = load_robot(urdf=chain, srdf=srdf)
    assert model.groups == {
        "all": ("ja", "jb", "jc"),
        "upper": ("ja", "jb"),
        "end": ("jc",),
        "one": ("jb",),
    }
    assert model.link_groups["end"] == ("c", "tool")
    assert model.link_groups["all"] == ("base", "a", "b", "c", "tool")


def test_state_leaves_joints_it_does_not_name_at_zero_or_the_nearest_limit(chain: Path) -> None:
    srdf = _srdf(chain.parent, '<group_state name="s" group="g"><joint name="jb" value="0.3"/></group_state>')
    np.testing.assert_allclose(load_robot(urdf=chain, srdf=srdf).postures["s"], [0.0, 0.3, 0.5])


def test_virtual_joint_of_a_state_places_the_floating_base(chain: Path) -> None:
    half = np.sqrt(0.5)
    srdf = _srdf(
        chain.parent,
        '<virtual_joint name="world" type="floating" parent_frame="map" child_link="base"/>'
        f'<group_state name="s" group="g"><joint name="world" value="1 2 3 0 0 {half} {half}"/></group_state>',
    )
    floating = load_robot(urdf=chain, srdf=srdf, root="floating")
    np.testing.assert_allclose(floating.postures["s"], [1, 2, 3, np.pi / 2, 0, 0, 0, 0, 0.5], atol=1e-12)
    np.testing.assert_allclose(load_robot(urdf=chain, srdf=srdf).postures["s"], [0, 0, 0.5])


def test_without_a_virtual_joint_the_root_joint_of_a_state_places_the_floating_base(chain: Path) -> None:
    def posture(value: str, more: str = "") -> np.ndarray:
        state = f'<group_state name="s" group="g"><joint name="root_joint" value="{value}"/></group_state>'
        return load_robot(urdf=chain, srdf=_srdf(chain.parent, more + state), root="floating").postures["s"]

    placed = [1, 2, 3, 0, 0, 0, 0, 0, 0.5]
    np.testing.assert_allclose(posture("1 2 3 0 0 0 1"), placed, atol=1e-12)
    np.testing.assert_allclose(posture("0"), np.multiply(placed, [0] * 6 + [1] * 3))
    virtual = '<virtual_joint name="world" type="floating" parent_frame="map" child_link="base"/>'
    np.testing.assert_allclose(posture("1 2 3 0 0 0 1", virtual), np.multiply(placed, [0] * 6 + [1] * 3))


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ('<group name="g"><chain base_link="b" tip_link="a"/></group>', "base_link 'b' is not above tip_link 'a'"),
        ('<group name="g"><group name="h"/></group>', "group 'h' is unknown"),
        ('<group name="g"><group name="h"/></group><group name="h"><group name="g"/></group>', "contains itself"),
        ('<group_state name="s" group="g"><joint name="ja" value="nan"/></group_state>', "'nan' is not a finite"),
        ('<group_state name="s" group="g"><joint name="ja" value="1 2"/></group_state>', "holds 2 numbers; 1"),
    ],
)
def test_srdf_that_does_not_fit_is_refused_in_one_line(chain: Path, body: str, message: str) -> None:
    with pytest.raises(RobotError, match=message) as refusal:
        load_robot(urdf=chain, srdf=_srdf(chain.parent, body))
    assert "\n" not in str(refusal.value)
    assert "robot.srdf" in str(refusal.value)


@pytest.mark.parametrize(
    ("body", "note"),
    [
        ('<group name="g"><joint name="jx"/></group>', "joint 'jx': the SRDF names it, the URDF does not; left out"),
        ('<group name="g"><link name="tol"/></group>', "link 'tol': the SRDF names it"),
        ('<group name="g"><chain base_link="base" tip_link="tol"/></group>', "link 'tol': the SRDF names it"),
        ('<group_state name="s" group="g"><joint name="jd" value="0"/></group_state>', "joint 'jd': the SRDF names it"),
        ('<disable_collisions link1="a" link2="q"/>', "link 'q': the SRDF names it"),
    ],
)
def test_names_that_only_the_srdf_has_are_left_out_with_a_note(chain: Path, body: str, note: str) -> None:
    robot = load_robot(urdf=chain, srdf=_srdf(chain.parent, body))
    assert len(robot.notes) == 1
    assert note in robot.notes[0]


def test_atlas_is_listed_with_a_description() -> None:
    assert "30 joints" in bundled_robots()["atlas"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "either"),
        ({"name": "atlas", "urdf": Path("x.urdf")}, "either"),
        ({"name": "atlas", "root": "hovering"}, "root 'hovering'"),
        ({"name": "atlas", "srdf": Path("x.srdf")}, "brings its own"),
        ({"urdf": Path("x.urdf"), "tool_distance_m": 0.2}, "tool_distance_m belongs to bundled robots"),
        ({"urdf": Path("missing.urdf")}, "missing.urdf: cannot be read"),
        (
            {"name": "atlas", "locked_joints": {"l_arm_elz": 0.0}},
            "'l_arm_elz' is not a movable joint; expected l_",
        ),
    ],
)
def test_arguments_that_do_not_fit_are_refused(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(RobotError, match=message):
        load_robot(**arguments)  # type: ignore[arg-type]
