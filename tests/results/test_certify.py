"""Motions of other planners: three that are certified, broken ones that are refuted with the place, and lies."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from other_planners import (
    GOAL,
    JOINTS,
    START,
    least_jerk,
    make_request,
    ramp_up_and_down,
    to_message,
    via_points,
)
from scipy.interpolate import CubicHermiteSpline

from service import JointTrajectory, RequestError, certify, load_request, parse_request, plan, read_trajectory
from service.replay.exchange.certify import to_json
from service.request.schema import PlanRequest
from service.verify import Status


@pytest.fixture(scope="module")
def request_of_arm(tmp_path_factory: pytest.TempPathFactory) -> PlanRequest:
    return parse_request(make_request(tmp_path_factory.mktemp("arm")))


def _make(columns: dict[str, np.ndarray], **changes: object) -> JointTrajectory:
    return JointTrajectory(JOINTS, **{**columns, **changes})  # type: ignore[arg-type]


def test_a_motion_of_moveit_is_certified_as_quintics(request_of_arm: PlanRequest, tmp_path: Path) -> None:
    message = to_message(ramp_up_and_down(via_points(), 1.0, 2.0, 0.1))
    path = tmp_path / "plan.yaml"
    path.write_text(yaml.safe_dump({"joint_trajectory": message, "multi_dof_joint_trajectory": {}}) + "---\n")
    outcome = certify(read_trajectory(path), request_of_arm)
    assert outcome.is_certified, outcome.failures
    assert "quintic" in outcome.certificate.notes[0]
    assert {"limits.speed", "limits.acceleration", "torque.motion", "target.motion.elbow", "start"} <= {
        check.name for check in outcome.certificate.checks
    }


def test_a_motion_of_curobo_in_single_precision_is_certified(request_of_arm: PlanRequest, tmp_path: Path) -> None:
    columns = least_jerk(via_points(), 1.6, 0.02)
    data = {"joint_names": list(JOINTS), "dt": 0.02}
    data |= {one: columns[many].tolist() for one, many in
             (("position", "positions"), ("velocity", "velocities"), ("acceleration", "accelerations"))}  # fmt: skip
    path = tmp_path / "plan.json"
    path.write_text(json.dumps({"interpolated_plan": data}))
    outcome = certify(read_trajectory(path), request_of_arm)
    assert outcome.is_certified, outcome.failures
    assert outcome.interpolation == "quintic"


def test_a_cubic_of_drake_is_certified_and_its_order_of_joints_does_not_matter(
    request_of_arm: PlanRequest, tmp_path: Path
) -> None:
    columns = least_jerk(via_points(), 1.6, 0.1)
    order = [2, 0, 3, 1]
    names = [JOINTS[k] for k in order]
    header = ["time", *names, *(f"velocity.{name}" for name in reversed(names))]
    table = np.column_stack([columns["times"], columns["positions"][:, order], columns["velocities"][:, order[::-1]]])
    path = tmp_path / "spline.csv"
    np.savetxt(path, table, delimiter=",", header=",".join(header), comments="", fmt="%.9g")
    outcome = certify(read_trajectory(path), request_of_arm)
    assert outcome.is_certified, outcome.failures
    assert outcome.interpolation == "cubic"


def test_a_path_of_tesseract_is_certified_without_times(request_of_arm: PlanRequest, tmp_path: Path) -> None:
    states = [
        {"joint_names": list(np.roll(JOINTS, row)), "position": np.roll(point, row).tolist(), "time": float(row)}
        for row, point in enumerate(via_points())
    ]
    path = tmp_path / "states.json"
    path.write_text(json.dumps(states))
    outcome = certify(read_trajectory(path), request_of_arm, timed=False)
    assert outcome.is_certified, outcome.failures
    assert outcome.certificate.coverage.not_checked == ("speeds, accelerations and forces (the motion is untimed)",)
    timed = certify(read_trajectory(path), request_of_arm)
    assert timed.certificate.status is Status.VIOLATED
    assert any("--interpolation spline" in note for note in timed.notes)


def test_our_own_plan_is_certified_from_its_arrays_and_its_table(request_of_arm: PlanRequest) -> None:
    result = plan(request_of_arm)
    arrays = (result.positions, result.velocities, result.accelerations)
    outcome = certify(JointTrajectory(result.joint_names, result.times, *arrays), request_of_arm)
    assert outcome.is_certified, outcome.failures
    assert outcome.certificate.min_clearance_m == pytest.approx(result.certificate.min_clearance_m, abs=2e-3)
    assert repr(outcome) == "<CertifiedTrajectory CERTIFIED, quintic>"
    assert repr(result).startswith(f"<PlanResult CERTIFIED, {len(result.times)} samples, ")


def test_points_that_are_free_with_a_post_between_them_are_refuted_with_the_place(request_of_arm: PlanRequest) -> None:
    outcome = certify(JointTrajectory(JOINTS, np.array([0.0, 4.0]), np.stack([START, GOAL])), request_of_arm, "spline")
    assert outcome.certificate.status is Status.VIOLATED
    hit = outcome.certificate.failed()[0]
    assert hit.name == "clearance"
    assert "post" in hit.where.names
    assert 0.5 < hit.where.time_s < 3.5
    assert any("penetrates" in line and " mm (at " in line for line in outcome.failures)


def test_velocities_that_make_the_cubic_leave_its_limits_are_refuted(request_of_arm: PlanRequest) -> None:
    columns = least_jerk(via_points(), 1.6, 0.4)
    columns["velocities"][5, 2] = 1.9  # within its limit at every point
    columns.pop("accelerations")
    outcome = certify(_make(columns), request_of_arm)
    broken = {check.name: check for check in outcome.certificate.failed()}
    curve = CubicHermiteSpline(columns["times"], columns["positions"], columns["velocities"])
    peak = np.abs(curve(np.linspace(0.0, 3.2, 20001), 2)).max() / 10.0
    assert peak > 1.0
    assert broken["limits.acceleration"].value == pytest.approx(peak, rel=1e-3)
    assert broken["limits.acceleration"].where.names == ("elbow",)


def test_a_speed_between_two_points_is_refuted(request_of_arm: PlanRequest) -> None:
    columns = least_jerk(via_points(), 0.9, 0.9)  # only points at rest: all speed is between them
    outcome = certify(_make(columns), request_of_arm)
    names = {check.name for check in outcome.certificate.failed()}
    assert "limits.speed" not in names
    assert certify(_make(least_jerk(via_points(), 0.7, 0.7)), request_of_arm).certificate.status is Status.VIOLATED


def test_a_goal_that_is_missed_and_a_start_elsewhere_are_refuted(request_of_arm: PlanRequest) -> None:
    columns = least_jerk(via_points(), 1.6, 0.1)
    short = {name: values[:-2] for name, values in columns.items()}
    failed = {check.name for check in certify(_make(short), request_of_arm).certificate.failed()}
    assert {"target.motion.base", "limits.rest"} <= failed
    late = {name: values[3:] for name, values in columns.items()}
    outcome = certify(_make(late), request_of_arm)
    assert outcome.certificate.checks[0].name == "start"
    assert not outcome.certificate.checks[0].ok
    assert "the request's start has" in outcome.failures[0]


def test_a_torque_beyond_its_limit_is_refuted(tmp_path: Path) -> None:
    request = make_request(tmp_path)
    urdf = Path(request["robot"]["urdf"])
    urdf.write_text(urdf.read_text().replace('effort="60"', 'effort="3"'))
    outcome = certify(_make(least_jerk(via_points(), 1.6, 0.1)), parse_request(request))
    assert "torque.motion" in {check.name for check in outcome.certificate.failed()}


def test_joints_that_are_left_out_stay_at_the_start_and_are_noted(request_of_arm: PlanRequest) -> None:
    columns = least_jerk(via_points(), 1.6, 0.1)
    part = {name: values if name == "times" else values[:, :3] for name, values in columns.items()}
    outcome = certify(JointTrajectory(JOINTS[:3], **part), request_of_arm)
    assert {check.name for check in outcome.certificate.failed()} == {"target.motion.wrist"}
    assert outcome.notes[0] == "the trajectory leaves out wrist: taken to stay at the request's start"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c: c["positions"].__setitem__((4, 1), np.nan), r"positions of 'shoulder' at point 4 is nan"),
        (lambda c: c["velocities"].__setitem__((4, 1), np.inf), r"velocities of 'shoulder' at point 4 is inf"),
        (lambda c: c["times"].__setitem__(5, c["times"][4]), r"times do not increase: point 4"),
        (lambda c: c["times"].__setitem__(0, -0.1), r"begins at -0.1 s"),
        (lambda c: c["times"].__imul__(1e6), r"are these milliseconds"),
        (lambda c: c.update(velocities=c["velocities"][:, :2]), r"velocities has the shape"),
        (lambda c: c.update(velocities=None), r"accelerations and no velocities"),
        (lambda c: c.update(joint_names=("base", "base", "elbow", "wrist")), r"'base' is given twice"),
        (lambda c: c.update(joint_names=("ba\x1b[31mse", "shoulder", "elbow", "wrist")), r"\\x1b\[31mse' is no name"),
        (lambda c: c.update(joint_names=("hip", "shoulder", "elbow", "wrist")), r"unknown joint 'hip'; arm has base"),
    ],
)
def test_lies_are_refused_in_one_line(request_of_arm: PlanRequest, change: object, words: str) -> None:
    columns: dict[str, object] = {"joint_names": JOINTS, **least_jerk(via_points(), 1.6, 0.1)}
    change(columns)  # type: ignore[operator]
    with pytest.raises(RequestError, match=words) as error:
        certify(JointTrajectory(**columns), request_of_arm)  # type: ignore[arg-type]
    assert all(line.isprintable() for line in str(error.value).splitlines())


def test_a_task_with_phases_of_its_own_is_refused(request_of_arm: PlanRequest, tmp_path: Path) -> None:
    data = make_request(tmp_path, task={"valve": {"centre": [1, 0, 1], "axis": [-1, 0, 0], "radius": 0.2}})
    data.pop("goal")
    with pytest.raises(RequestError, match=r"task.valve: its phases are made by the planner"):
        certify(_make(least_jerk(via_points(), 1.6, 0.1)), parse_request(data))


def test_the_summary_names_interpolation_and_place(request_of_arm: PlanRequest) -> None:
    summary = to_json(certify(_make(least_jerk(via_points(0.0), 1.6, 0.1)), request_of_arm))
    assert summary["verdict"] == "VIOLATED"
    assert summary["interpolation"] == "quintic"
    assert "penetrates" in summary["explanation"][0]
    json.dumps(summary, allow_nan=False)


def test_a_robot_on_its_feet_is_certified_with_its_balance_and_refuted_where_a_foot_slides() -> None:
    request = load_request(Path(__file__).parents[2] / "examples" / "requests" / "pose_goal.yaml")
    result = plan(request)
    arrays = {"positions": result.positions, "velocities": result.velocities}
    outcome = certify(JointTrajectory(result.joint_names, result.times, **arrays), request, robot=result.robot)
    assert outcome.is_certified, outcome.failures
    assert outcome.certificate.min_balance_margin_m == pytest.approx(result.certificate.min_balance_margin_m, abs=1e-3)
    slid = result.positions.copy()
    slid[:, 0] += 0.004 * np.sin(np.pi * result.times / result.times[-1]) ** 2
    outcome = certify(JointTrajectory(result.joint_names, result.times, slid), request, "spline", robot=result.robot)
    assert any(check.name.startswith("planted.motion.") for check in outcome.certificate.failed())
    assert any("foot" in line and " s, after point " in line for line in outcome.failures)


def test_lists_are_taken_and_what_is_no_number_or_no_interpolation_is_refused(request_of_arm: PlanRequest) -> None:
    columns = {name: values.tolist() for name, values in least_jerk(via_points(), 1.6, 0.1).items()}
    trajectory = JointTrajectory(list(JOINTS), **columns)  # type: ignore[arg-type]
    assert certify(trajectory, request_of_arm).is_certified
    with pytest.raises(RequestError, match="interpolation: 'b-spline' is unknown; expected auto, linear"):
        certify(trajectory, request_of_arm, "b-spline")  # type: ignore[arg-type]
    with pytest.raises(RequestError, match="positions must be numbers, one row per point"):
        JointTrajectory(JOINTS, None, [[0.0, 1.0, 2.0, 3.0], [0.0]])  # type: ignore[arg-type]
