"""Result folders: complete, written atomically, and read back as the same motion."""

from __future__ import annotations

import csv
import json
import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from posed_results import make_graph
from scipy.spatial.transform import Rotation
from small_plan import small_plan

from costs.robot import load_robot
from service.errors import ResultError
from service.replay.replay import read_motion, verify_result
from service.result import output
from service.result.folder import check_folder, read_result
from service.result.motion_json import file_columns, file_positions, samples_of
from service.result.output import write_result
from service.result.phase_json import phase_from_json, phase_json
from service.result.result import PlanResult, Verdict
from service.verify import Phase, PlantedContact, Status

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def plan() -> PlanResult:
    return small_plan()


@pytest.fixture(scope="module")
def folder(plan: PlanResult, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_result(plan, tmp_path_factory.mktemp("results") / "plan").folder


def test_the_small_plan_is_certified(plan: PlanResult) -> None:
    assert plan.certificate is not None
    assert plan.certificate.status is Status.CERTIFIED, [check.text for check in plan.certificate.failed()]


def test_a_result_folder_holds_every_documented_key(folder: Path) -> None:
    text = (ROOT / "docs" / "result-format.md").read_text()
    rows = [line.split("|")[1] for line in text.splitlines() if line.startswith("| `")]
    keys = {name for row in rows for name in row.replace("`", "").replace(" ", "").split(",") if "." not in name}
    data = read_result(folder)
    assert keys <= data.keys()
    assert data.keys() - keys <= {"min_clearance_pair", "request_hash"}
    for name in ("trajectory.csv", "viewer.html", "scene.glb", "openrave/environment.xml", "openrave/trajectory.xml"):
        assert (folder / name).stat().st_size > 500


def test_nothing_but_the_folder_is_left_beside_it(folder: Path) -> None:
    assert [path.name for path in folder.parent.iterdir()] == ["plan"]


def test_the_written_robot_is_the_robot(plan: PlanResult, folder: Path) -> None:
    data = read_result(folder)["robot"]
    robot = load_robot(
        urdf=folder / data["urdf"],
        srdf=folder / data["srdf"],
        package_dirs=[folder / name for name in data["package_dirs"]],
        root=data["root"],
    )
    assert robot.joint_names == plan.robot.joint_names
    for name in ("lower", "upper", "velocity", "acceleration", "effort"):
        np.testing.assert_array_equal(getattr(robot, name), getattr(plan.robot, name))
    assert robot.ignored_pairs == plan.robot.ignored_pairs
    for body, original in zip(robot.bodies, plan.robot.bodies, strict=True):
        np.testing.assert_allclose(body.vertices, original.vertices, atol=1e-12)


def test_bodies_are_written_in_the_frames_of_their_links(plan: PlanResult, folder: Path) -> None:
    # A world position computed twice: through the joint (planner) and through the link (reader of the file).
    data = plan.robot.model.createData()
    pin.framesForwardKinematics(plan.robot.model, data, plan.start)
    for written, body in zip(read_result(folder)["bodies"], plan.robot.bodies, strict=True):
        through_joint = np.array([data.oMi[body.joint].act(v) for v in body.vertices])
        frame = data.oMf[plan.robot.model.getFrameId(written["link"])]
        through_link = np.array([frame.act(np.array(v)) for v in written["vertices"]])
        np.testing.assert_allclose(through_link, through_joint, atol=1e-9)


def test_the_base_is_written_as_position_and_quaternion() -> None:
    robot = load_robot("atlas")
    rng = np.random.default_rng(1)
    q = np.tile(robot.postures["stand"], (50, 1))
    q[:, :6] = np.cumsum(0.2 * rng.normal(size=(50, 6)), axis=0)
    q[:, 3] = np.linspace(0.0, 10.0, 50)  # more than one turn, so that the quaternion changes its sign
    q[:, 4] = np.clip(q[:, 4], -1.4, 1.4)
    rows = file_positions(robot, q)
    assert file_columns(robot)[:7] == ("base_x", "base_y", "base_z", "base_qw", "base_qx", "base_qy", "base_qz")
    for row, configuration in zip(rows, q, strict=True):
        yaw, pitch, roll = configuration[3:6]
        # Intrinsic z-y-x, written out: Rz(yaw) Ry(pitch) Rx(roll).
        expected = Rotation.from_euler("z", yaw) * Rotation.from_euler("y", pitch) * Rotation.from_euler("x", roll)
        actual = Rotation.from_quat(row[3:7], scalar_first=True)
        assert (expected.inv() * actual).magnitude() < 1e-9
    assert np.all(np.sum(rows[1:, 3:7] * rows[:-1, 3:7], axis=1) > 0.0)


def test_csv_and_json_hold_the_same_samples(folder: Path) -> None:
    trajectory = read_result(folder)["trajectory"]
    with (folder / "trajectory.csv").open() as file:
        header, *rows = csv.reader(file)
    width = 1 + len(trajectory["joint_names"])
    assert header[:width] == ["time", *trajectory["joint_names"]]
    table = np.array(rows, dtype=float)[:, :width]
    np.testing.assert_allclose(table[:, 0], trajectory["times"], rtol=1e-9)
    np.testing.assert_allclose(table[:, 1:], trajectory["positions"], atol=1e-9)


def test_a_motion_read_back_is_the_motion_written(plan: PlanResult, folder: Path) -> None:
    written, motion = plan.motion, read_motion(read_result(folder), folder)
    assert written is not None
    assert motion.robot.joint_names == written.robot.joint_names
    assert motion.mechanism_links == {"wheel"}
    np.testing.assert_array_equal(motion.curve.positions, written.curve.positions)
    np.testing.assert_array_equal(samples_of(motion), samples_of(written))
    for phase, original in zip(motion.phases, written.phases, strict=True):
        assert (phase.name, phase.first, phase.last) == (original.name, original.first, original.last)
        assert phase.allowances == original.allowances
        for contact, planted in zip(phase.contacts, original.contacts, strict=True):
            np.testing.assert_allclose(contact.pose_world_link, planted.pose_world_link, atol=1e-12)
            np.testing.assert_allclose(contact.sole, planted.sole, atol=1e-12)
        for target, wanted in zip(phase.targets, original.targets, strict=True):
            assert type(target) is type(wanted)
            for name, value in vars(wanted).items():
                if value is None or isinstance(value, str):
                    assert getattr(target, name) == value
                else:
                    np.testing.assert_allclose(getattr(target, name), value, atol=1e-12)


def test_a_contact_keeps_its_pose_and_its_sole_corners() -> None:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("zyx", [0.4, 0.3, 0.2]).as_matrix()
    pose[:3, 3] = [1.0, 2.0, 3.0]
    sole = np.array([[0.1, 0.05, 0.0], [0.1, -0.05, 0.0], [-0.1, 0.05, 0.0]])
    samples = np.array([0.0, 1.0])
    written = phase_json(Phase("p", 0.0, 1.0, (PlantedContact("foot", pose, sole, 2e-3, 3e-4),)), samples)
    world = pose[:3, :3] @ sole[0] + pose[:3, 3]
    np.testing.assert_allclose(written["contacts"][0]["sole"][0], world, atol=1e-12)
    (contact,) = phase_from_json(written, samples).contacts
    np.testing.assert_allclose(contact.sole, sole, atol=1e-12)
    np.testing.assert_allclose(contact.pose_world_link, pose, atol=1e-12)
    assert (contact.tolerance_m, contact.knot_tolerance_m) == (2e-3, 3e-4)


def test_without_a_motion_the_start_can_be_looked_at(plan: PlanResult, tmp_path: Path) -> None:
    nothing = replace(plan, verdict=Verdict.INFEASIBLE, motion=None, certificate=None, explanation=("too far",))
    files = write_result(nothing, tmp_path / "nothing")
    data = read_result(files.folder)
    assert data["curve"] is None
    assert data["explanation"] == ["too far"]
    assert len(data["trajectory"]["positions"]) == 1
    assert files.viewer.stat().st_size > 100_000
    with pytest.raises(ResultError, match="no motion to verify; its verdict is 'INFEASIBLE'"):
        verify_result(files.folder)


def test_an_earlier_result_is_replaced_as_a_whole(plan: PlanResult, tmp_path: Path) -> None:
    first = write_result(plan, tmp_path / "plan")
    (first.folder / "robot" / "left-over").write_text("old")
    write_result(replace(plan, notes=("second",)), tmp_path / "plan")
    assert read_result(first.folder)["notes"] == ["second"]
    assert not (first.folder / "robot" / "left-over").exists()


def test_what_is_not_of_a_result_is_never_replaced(plan: PlanResult, tmp_path: Path) -> None:
    files = write_result(plan, tmp_path / "plan")
    (files.folder / "thesis.tex").write_text("years of work")
    with pytest.raises(ResultError, match=r"holds thesis\.tex, which is of no result"):
        write_result(plan, files.folder)
    assert (files.folder / "thesis.tex").read_text() == "years of work"
    other = tmp_path / "other"
    other.mkdir()
    (other / "result.json").write_text('{"score": 1}')
    with pytest.raises(ResultError, match=r"holds a result\.json of something else"):
        check_folder(other)


def test_an_interruption_between_the_two_renames_brings_the_earlier_result_back(
    plan: PlanResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_result(plan, tmp_path / "plan")
    rename = os.rename

    def interrupted(source: Path, target: Path) -> None:
        rename(source, target)
        if target.name == "earlier":
            raise KeyboardInterrupt

    monkeypatch.setattr(os, "rename", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_result(replace(plan, notes=("second",)), tmp_path / "plan")
    assert read_result(tmp_path / "plan")["notes"] == ["made by hand"]


@pytest.mark.parametrize("interruption", [KeyboardInterrupt, OSError(28, "No space left on device")])
def test_an_interrupted_write_leaves_the_earlier_result_and_nothing_else(
    plan: PlanResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, interruption: BaseException
) -> None:
    write_result(plan, tmp_path / "plan")

    def interrupted(*args: object) -> None:
        raise interruption

    monkeypatch.setattr(output, "write_viewer", interrupted)
    with pytest.raises((KeyboardInterrupt, ResultError)):
        write_result(replace(plan, notes=("second",)), tmp_path / "plan")
    assert [path.name for path in tmp_path.iterdir()] == ["plan"]
    assert read_result(tmp_path / "plan")["notes"] == ["made by hand"]


def test_a_graph_of_poses_comes_to_the_page_with_the_links_of_its_poses(plan: PlanResult, tmp_path: Path) -> None:
    graph = make_graph()
    graph["poses"] = [{**pose, "q": plan.start[: plan.robot.n].tolist()} for pose in graph["poses"]]
    page = write_result(replace(plan, pose_graph=graph), tmp_path / "plan").viewer.read_text("utf-8")
    payload = re.search(r'id="payload">(.*?)</script>', page, re.DOTALL)
    assert payload is not None
    drawn = json.loads(payload.group(1))["pose_graph"]
    assert len(drawn["poses"]) == len(graph["poses"])
    assert set(drawn["links"]) == {body.link for body in plan.robot.bodies}


def test_an_earlier_result_returns_when_the_new_one_cannot_take_its_place(
    plan: PlanResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_result(plan, tmp_path / "plan")
    rename = os.rename

    def refuse_fresh(source: Path, target: Path) -> None:
        if Path(source).name == "fresh":
            raise OSError(5, "Input/output error")
        rename(source, target)

    monkeypatch.setattr(os, "rename", refuse_fresh)
    with pytest.raises(ResultError, match="cannot be written: Input/output error"):
        write_result(plan, tmp_path / "plan")
    assert [path.name for path in tmp_path.iterdir()] == ["plan"]
    assert read_result(tmp_path / "plan")["notes"] == ["made by hand"]


def test_a_folder_with_other_things_is_not_replaced(plan: PlanResult, tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(ResultError, match=r"holds other files and no result\.json; name a new or empty folder"):
        check_folder(tmp_path)
    with pytest.raises(ResultError, match="is a file; name a folder"):
        check_folder(tmp_path / "thesis.tex")
    check_folder(tmp_path / "new")
    with pytest.raises(ResultError, match="holds other files"):
        write_result(plan, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        ("", "is no JSON"),
        ("[1]", r"format is \[1\]; expected 'scopt-result/3', or that of an earlier version"),
        ('{"format": "scopt-result/9"}', "format is 'scopt-result/9'"),
        ('{"format": NaN}', "NaN is no number that JSON has"),
        ('{"format": "scopt-result/1"}', "has no motion to verify"),
        ('{"format": "scopt-result/1", "curve": {}}', "lacks 'robot'"),
        ("[" * 100_000, "is no JSON"),
    ],
)
def test_a_broken_result_is_refused_in_one_line(tmp_path: Path, content: str, problem: str) -> None:
    (tmp_path / "result.json").write_text(content)
    with pytest.raises(ResultError, match=problem) as caught:
        verify_result(tmp_path)
    assert "\n" not in str(caught.value)
