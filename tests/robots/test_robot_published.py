"""Robots in the form in which Drake, Unitree, ANYbotics and ROS packages publish them, written anew and made small."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from robot_files import CUBE_OBJ

from costs.robot import RobotModel, load_robot
from service import certify, load_request, parse_request, plan, read_trajectory, write_result
from service.replay.replay import verify_result

INERTIA = '<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/>'
COLLADA = """<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit name="millimeter" meter="0.001"/><up_axis>Z_UP</up_axis></asset>
<library_geometries><geometry id="cube"><mesh>
<source id="points"><float_array id="numbers" count="24">0 0 0 100 0 0 0 100 0 100 100 0 0 0 100 100 0 100 0 100 100
100 100 100</float_array><technique_common><accessor source="#numbers" count="8" stride="3">
  <param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="corners"><input semantic="POSITION" source="#points"/></vertices>
<triangles count="4"><input semantic="VERTEX" source="#corners" offset="0"/><p>0 1 2 1 3 2 4 5 6 5 7 6</p></triangles>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="scene"><node><instance_geometry url="#cube"/></node></visual_scene>
</library_visual_scenes><scene><instance_visual_scene url="#scene"/></scene></COLLADA>"""

DRAKE = f"""<?xml version="1.0"?>
<robot name="arm_on_table" xmlns:drake="http://drake.mit.edu">
  <material name="grey"><color rgba="0.5 0.5 0.5 1"/></material>
  <link name="world"/>
  <link name="base">
    <inertial><origin xyz="0 0 0.05"/><mass value="5"/>{INERTIA}</inertial>
    <collision name="base_box"><geometry><box size="0.2 0.2 0.1"/></geometry>
      <drake:proximity_properties><drake:rigid_hydroelastic/><drake:mu_dynamic value="0.5"/>
        </drake:proximity_properties>
    </collision>
  </link>
  <link name="upper"><inertial><mass value="2"/>{INERTIA}</inertial>
    <collision><origin xyz="0 0 0.2"/><geometry><drake:capsule radius="0.04" length="0.25"/></geometry></collision>
      </link>
  <link name="fore"><inertial><mass value="1"/>{INERTIA}</inertial>
    <collision><origin xyz="0 0 0.15"/><geometry><drake:ellipsoid a="0.03" b="0.03" c="0.12"/></geometry></collision>
    <collision><geometry><sphere radius="0"/></geometry></collision></link>
  <joint name="weld" type="fixed"><parent link="world"/><child link="base"/></joint>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.1"/>
    <axis xyz="0 1 0"/><limit effort="50" lower="-2" upper="2" velocity="2" drake:acceleration="6.5"/>
    <dynamics damping="0.5"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/><origin xyz="0 0 0.4"/>
    <axis xyz="0 1 0"/><limit effort="30" lower="-2.5" upper="2.5" velocity="2"/></joint>
  <transmission type="SimpleTransmission" name="t"><actuator name="shoulder"/><joint name="shoulder"/>
    <mechanicalReduction>1</mechanicalReduction></transmission>
  <drake:collision_filter_group name="group"><drake:member link="base"/>
    <drake:ignored_collision_filter_group name="group"/>
  </drake:collision_filter_group>
</robot>"""

UNITREE = f"""<robot name="dog">
  <mujoco><compiler meshdir="../meshes/" discardvisual="false"/></mujoco>
  <!-- [CAUTION] uncomment when convert to mujoco: <link name="world"/> -->
  <link name="trunk"><inertial><mass value="6"/>{INERTIA}</inertial>
    <visual><geometry><mesh filename="../meshes/trunk.STL"/></geometry></visual>
    <collision><geometry><box size="0.4 0.1 0.1"/></geometry></collision></link>
  <link name="imu"><inertial><mass value="0"/><inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial>
    </link>
  <joint name="imu_joint" type="fixed" dont_collapse="true"><parent link="trunk"/><child link="imu"/>
    <axis xyz="1 0 0"/>
  </joint>
  {{legs}}
  <gazebo reference="trunk"><mu1>0.2</mu1><kp value="1000000.0"/></gazebo>
  <gazebo><plugin filename="libgazebo_ros_control.so" name="control"><robotNamespace>/dog</robotNamespace></plugin>
    </gazebo>
</robot>"""
LEG = f"""
  <link name="{{side}}_thigh"><inertial><mass value="1"/>{INERTIA}</inertial><collision><origin rpy="0 1.5707963 0"
    xyz="0 0 -0.1"/><geometry><box size="0.2 0.025 0.034"/></geometry></collision></link>
  <link name="{{side}}_foot"><inertial><mass value="0.06"/>{INERTIA}</inertial><collision><origin xyz="0 0 -0.2"/>
    <geometry><sphere radius="0.02"/></geometry></collision></link>
  <joint name="{{side}}_hip" type="revolute"><origin xyz="0.18 {{y}} 0"/><parent link="trunk"/>
    <child link="{{side}}_thigh"/>
    <axis xyz="0 1 0"/><dynamics damping="0" friction="0"/>
      <limit effort="23.7" lower="-1.5" upper="3.4" velocity="30.1"/>
    <safety_controller k_velocity="10" soft_lower_limit="-1" soft_upper_limit="3"/></joint>
  <joint name="{{side}}_knee" type="revolute"><origin xyz="0 0 -0.2"/><parent link="{{side}}_thigh"/>
    <child link="{{side}}_foot"/><axis xyz="0 1 0"/><limit effort="35.55" lower="-2.7" upper="-0.8" velocity="20"/>
      </joint>
  <transmission name="{{side}}_tran"><type>transmission_interface/SimpleTransmission</type><joint name="{{side}}_hip">
    <hardwareInterface>hardware_interface/EffortJointInterface</hardwareInterface></joint></transmission>"""

ANYBOTICS = f"""<?xml version="1.0" ?>
<!-- ====== |    This document was autogenerated by xacro from anymal.urdf.xacro | ====== -->
<robot name="walker" xmlns:xi="http://www.w3.org/2001/XInclude">
  <link name="base"><visual><geometry><mesh filename="package://walker_description/meshes/none.dae"/></geometry>
    </visual>
    <collision name="hull"><geometry><mesh filename="package://walker_description/meshes/base.dae" scale="1 1 1"/>
      </geometry>
    </collision></link>
  <link name="base_inertia"><inertial><origin rpy="0 0 0" xyz="-0.002 0 0.02"/>
    <mass value="17"/>{INERTIA}</inertial></link>
  <joint name="base_to_inertia" type="fixed"><parent link="base"/><child link="base_inertia"/></joint>
  <link name="LF_HIP"><inertial><mass value="2"/>{INERTIA}</inertial>
    <collision><origin rpy="0 1.5707963 0" xyz="0 0 0.1"/><geometry><cylinder length="0.08" radius="0.06"/>
      </geometry></collision>
    <sensor:camera/></link>
  <joint name="LF_HAA" type="continuous"><parent link="base"/><child link="LF_HIP"/>
    <origin rpy="2.6 0 -1.5" xyz="0.3 0.1 0.3"/>
    <axis xyz="-1 0 0"/><limit effort="80" velocity="7.5" lower="-inf" upper="inf"/></joint>
  <joint name="rest" type="revolute"><parent link="LF_HIP"/><child link="LF_TIP"/><axis xyz="0 0 1"/>
    <origin xyz="0 0 0.3"/>
    <limit effort="80" velocity="7.5" lower="-9.42e9" upper="9.42e9"/></joint>
  <link name="LF_TIP"><inertial><mass value="0.1"/>{INERTIA}</inertial>
    <collision><geometry><sphere radius="0.03"/></geometry></collision></link>
</robot>"""


def _write(folder: Path, text: str) -> Path:
    """A package ``walker_description`` in a folder of another name, as a checkout has."""
    package = folder / "checkout"
    for name in ("urdf", "meshes"):
        (package / name).mkdir(parents=True)
    (package / "package.xml").write_text(
        '<?xml version="1.0"?><package format="3"><name>walker_description</name></package>'
    )
    (package / "meshes" / "base.dae").write_text(COLLADA)
    (package / "meshes" / "cube.obj").write_text(CUBE_OBJ)
    urdf = package / "urdf" / "robot.urdf"
    urdf.write_text(text, encoding="utf-8")
    return urdf


def _load(urdf: Path) -> RobotModel:
    return load_robot(urdf=urdf, package_dirs=[urdf.parents[1]])


def _plan(urdf: Path, goal: dict[str, float], start: dict[str, float] | None = None, **robot: Any) -> Any:
    data = {
        "robot": {"urdf": str(urdf), "package_dirs": [str(urdf.parents[1])], **robot},
        "goal": {"joints": goal},
        **({} if start is None else {"start": {"joints": start}}),
    }
    return plan(parse_request(data, folder=urdf.parent))


def test_a_robot_with_drakes_elements_is_certified(tmp_path: Path) -> None:
    urdf = _write(tmp_path, DRAKE)
    robot = _load(urdf)
    assert [body.name for body in robot.bodies] == ["base", "upper", "fore"]
    np.testing.assert_allclose(robot.acceleration, [6.5, 10.0])
    # The capsule is 0.25 m long without its caps.
    np.testing.assert_allclose(np.ptp(robot.bodies[1].vertices[:, 2]), 0.33, atol=5e-3)
    np.testing.assert_allclose(np.ptp(robot.bodies[2].vertices, axis=0), [0.06, 0.06, 0.24], atol=1e-9)
    assert any("an ellipsoid is taken as the box around it" in note for note in robot.notes)
    result = _plan(urdf, {"shoulder": 0.5, "elbow": 0.5})
    assert result.verdict.value == "CERTIFIED", result.explanation


def test_a_dog_with_elements_for_two_simulators_is_certified(tmp_path: Path) -> None:
    legs = "".join(LEG.format(side=side, y=y) for side, y in (("FL", 0.13), ("FR", -0.13)))
    urdf = _write(tmp_path, UNITREE.format(legs=legs))
    assert _load(urdf).joint_names == ("FL_hip", "FL_knee", "FR_hip", "FR_knee")
    knees = {"FL_knee": -1.5, "FR_knee": -1.5}
    result = _plan(urdf, {"FL_hip": 0.8, "FR_hip": 0.3}, {"FL_hip": 0.6, "FR_hip": 0.6, **knees})
    assert result.verdict.value == "CERTIFIED", result.explanation


def test_a_walker_of_a_package_of_another_name_is_certified(tmp_path: Path) -> None:
    urdf = _write(tmp_path, ANYBOTICS)
    robot = _load(urdf)
    assert np.all(np.isinf(robot.lower))
    # The mesh is in millimetres, as its file says.
    np.testing.assert_allclose(np.ptp(robot.bodies[0].vertices, axis=0), 0.1, atol=1e-9)
    result = _plan(urdf, {"LF_HAA": -0.5, "rest": 1.0})
    assert result.verdict.value == "CERTIFIED", result.explanation


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("ball", "joint 'elbow': type 'ball' is not supported"),
        ("universal", "joint 'elbow': type 'universal' is not supported"),
    ],
)
def test_joints_that_only_drake_has_are_named(tmp_path: Path, kind: str, words: str) -> None:
    start, end = DRAKE.split('<joint name="elbow" type="revolute">')
    end = end.replace("</joint>", "</drake:joint>", 1)
    urdf = _write(tmp_path, f'{start}<drake:joint name="elbow" type="{kind}">{end}')
    with pytest.raises(Exception, match=words):
        _load(urdf)


@pytest.mark.parametrize(
    ("old", "new", "note"),
    [
        ('lower="-2" upper="2"', 'lower="-120" upper="120"', "joint 'shoulder': limits of -120 to 120 rad"),
        ('lower="-2" upper="2"', 'lower="0" upper="0"', "joint 'shoulder': its limits are 0 and 0"),
        ("0.2 0.2 0.1", "200 200 100", "link 'base': a box of 200 m is read as it is; are these millimetres?"),
        (
            '<box size="0.2 0.2 0.1"/>',
            '<mesh filename="meshes/cube.obj" scale="100 100 100"/>',
            "is it in millimetres?",
        ),
    ],
)
def test_a_unit_that_can_hardly_be_meant_becomes_a_note(tmp_path: Path, old: str, new: str, note: str) -> None:
    assert any(note in line for line in _load(_write(tmp_path, DRAKE.replace(old, new, 1))).notes)


def test_a_model_of_another_simulator_is_named(tmp_path: Path) -> None:
    with pytest.raises(Exception, match=r"the root element is <sdf> \(a model of Gazebo\); it must be <robot>"):
        _load(_write(tmp_path, "<sdf/>"))


def test_what_was_planned_without_package_folders_is_verified_and_certified_without_them(tmp_path: Path) -> None:
    urdf = _write(tmp_path, ANYBOTICS)
    path = tmp_path / "request.yaml"
    path.write_text(f"robot: {{urdf: {urdf}}}\ngoal: {{joints: {{LF_HAA: -0.5}}}}\n")
    request = load_request(path)
    result = plan(request)
    assert result.verdict.value == "CERTIFIED", result.explanation
    write_result(result, tmp_path / "out")
    assert verify_result(tmp_path / "out", path)["verdict"] == "CERTIFIED"
    outcome = certify(read_trajectory(tmp_path / "out" / "trajectory.csv"), request)
    assert outcome.is_certified, outcome.failures
