"""Reaching among obstacles, from request to certificate, for the bundled robot and for other people's."""

import numpy as np
import pytest
from clocks import CountingClock
from planar_arm import write_planar_arm
from shared_plans import write_undrawn
from stranger import Stranger

from costs.kinematics import locate_links
from service import planner
from service import verify as verifier
from service.body.aims import Aims
from service.body.monitor import Monitor
from service.body.poses import find_pose
from service.body.whole_body import WholeBody
from service.planner import plan
from service.request.file import parse_request
from service.request.schema import Options, PlanRequest
from service.request.tasks.reach import GoalRequest, PoseGoalRequest
from service.result.attempt import Attempt
from service.result.result import Verdict
from service.setup.prepare import prepare
from service.tasks.reach.goal import Goal
from service.tasks.reach.goal_poses import bring_to_goal

TABLE = {"name": "table", "type": "box", "size": [0.5, 1.2, 0.05], "position": [0.75, 0.0, 0.9]}
POST = {"name": "post", "type": "cylinder", "radius": 0.04, "height": 2.0, "position": [0.5, 0.45, 1.0]}
FORWARD = [0.7071068, 0.0, 0.7071068, 0.0]  # the tool's z axis along the world's x


def atlas(goal: dict, obstacles: tuple = (TABLE, POST), **options) -> PlanRequest:
    return parse_request(
        {
            "robot": {"name": "atlas"},
            "start": {"posture": "stand"},
            "scene": {"obstacles": list(obstacles)},
            "goal": goal,
            "options": options,
        }
    )


def tool_at(position: list[float], **more) -> dict:
    return {"poses": [{"link": "l_tool", "position": position, **more}]}


@pytest.fixture(scope="module")
def reached(tmp_path_factory):
    """A certified whole-body reach and its folder."""
    request = atlas(tool_at([0.6, 0.2, 1.15], quaternion_wxyz=FORWARD, free_axis="z"))
    result = plan(request)
    folder = tmp_path_factory.mktemp("reach") / "out"
    write_undrawn(result, folder)
    return result, Stranger(folder)


def test_a_reach_among_obstacles_is_certified(reached):
    result, _ = reached
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    assert result.explanation == ()
    assert result.certificate.min_clearance_m > 0.0


def test_the_tool_arrives_with_its_axis_as_asked(reached):
    _, stranger = reached
    tool = stranger.placements(stranger.positions[-1])["l_tool"]
    assert np.linalg.norm(tool.translation - [0.6, 0.2, 1.15]) < 2e-3
    assert tool.rotation[:, 2] @ [1.0, 0.0, 0.0] > np.cos(np.deg2rad(0.6))


def test_dense_samples_keep_the_certified_clearance(reached):
    result, stranger = reached
    planted = {"l_foot", "r_foot"}
    clearance, pair = stranger.closest(
        stranger.rows(2, stride=4), lambda body, link, piece: link in planted and piece == "floor"
    )
    assert clearance >= result.certificate.min_clearance_m - 1e-6, pair


def test_feet_stay_planted_and_the_legs_move(reached):
    _, stranger = reached
    first = stranger.placements(stranger.positions[0])
    for row in stranger.rows(2):
        now = stranger.placements(row)
        for foot in ("l_foot", "r_foot"):
            assert np.linalg.norm(now[foot].translation - first[foot].translation) < 1e-3
            corner = np.array([0.17, 0.06, -0.076])
            assert np.linalg.norm(now[foot].act(corner) - first[foot].act(corner)) < 1e-3
    legs = [i for i, name in enumerate(stranger.names) if "_leg_" in name]
    assert np.abs(np.diff(stranger.positions[:, legs], axis=0)).sum() > 0.05


def test_the_balance_point_stays_inside_by_the_margin(reached):
    result, stranger = reached
    from costs.support import SupportPolygon

    polygon = SupportPolygon.of_points(result.motion.phases[0].support.polygon)
    coms = np.array([stranger.com(row)[:2] for row in stranger.rows(1, stride=2)])
    assert polygon.margin(coms).min() >= Options().balance_margin_m - 1e-6


def test_joint_goals_are_met_exactly():
    result = plan(atlas({"joints": {"l_arm_elx": 1.2, "r_arm_elx": -1.2}}, obstacles=()))
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    names, last = result.robot.joint_names, result.motion.curve.positions[-1]
    assert last[names.index("l_arm_elx")] == pytest.approx(1.2, abs=1e-6)
    assert last[names.index("r_arm_elx")] == pytest.approx(-1.2, abs=1e-6)


def test_a_named_posture_is_a_goal():
    result = plan(atlas({"posture": "reach_ready"}, obstacles=()))
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    names, last = result.robot.joint_names, result.motion.curve.positions[-1]
    for name, value in zip(names[6:], result.robot.postures["reach_ready"][6:], strict=True):
        assert last[names.index(name)] == pytest.approx(value, abs=1e-3)


def test_a_target_beyond_the_chain_is_infeasible_with_its_distance():
    result = plan(atlas(tool_at([3.6, 0.2, 1.15])))
    assert result.verdict is Verdict.INFEASIBLE
    assert "l_tool cannot reach [3.6, 0.2, 1.15]: it is" in result.explanation[0]
    assert result.motion is None


def test_a_target_inside_an_obstacle_is_infeasible_and_names_link_and_obstacle():
    result = plan(atlas(tool_at([0.75, 0.0, 0.9])))
    assert result.verdict is Verdict.INFEASIBLE
    (line,) = result.explanation
    assert line.startswith("the goal is in collision: with l_tool at [0.75, 0.0, 0.9], however it is turned, l_hook is")
    assert "inside table" in line


def test_a_slot_too_narrow_for_the_hand_names_link_and_board_and_comes_with_the_best_attempt():
    boards = ({"name": f"{name} board", "type": "box", "size": [0.4, 0.6, 0.02], "position": [0.7, 0.2, z]}
              for name, z in (("lower", 1.03), ("upper", 1.07)))  # fmt: skip
    result = plan(atlas(tool_at([0.6, 0.2, 1.05]), obstacles=tuple(boards), starts=1))
    assert result.verdict is Verdict.NOT_FOUND
    assert any("board" in line and "l_h" in line for line in result.explanation), result.explanation
    assert result.motion is not None
    assert result.certificate is not None
    assert result.certificate.failed()


@pytest.fixture
def late_after_an_attempt(monkeypatch):
    """Time is up as soon as a task's planner has handed over its first plan, whatever the clock says."""
    begun, begin = [], Attempt.begin

    def note(self, task):
        begin(self, task)
        begun.append(task)

    monkeypatch.setattr(Attempt, "begin", note)
    monkeypatch.setattr(Monitor, "remaining_s", lambda self: -1.0 if begun else 60.0)


def test_a_late_plan_comes_with_its_best_attempt_and_reasons_and_without_a_certificate(
    late_after_an_attempt, monkeypatch
):
    boards = ({"name": f"{name} board", "type": "box", "size": [0.4, 0.6, 0.02], "position": [0.7, 0.2, z]}
              for name, z in (("lower", 1.03), ("upper", 1.07)))  # fmt: skip
    monkeypatch.setattr(planner, "GRACE_S", 60.0)  # however busy the machine is
    monkeypatch.setattr(planner, "verify", lambda motion: pytest.fail("a certificate was begun after the limit"))
    result = plan(atlas(tool_at([0.6, 0.2, 1.05]), obstacles=tuple(boards), starts=1))
    assert result.verdict is Verdict.TIME_LIMIT
    assert result.explanation[0].startswith("the default limit of 60 s")
    assert any("board" in line for line in result.explanation[1:]), result.explanation
    assert result.motion is not None
    assert result.certificate is None


def test_a_verification_that_runs_into_the_limit_gives_the_motion_and_no_certificate(monkeypatch):
    is_verifying = []

    def verify(motion, settings=None):
        is_verifying.append(motion)
        return verifier.verify(motion)

    monkeypatch.setattr(planner, "verify", verify)
    monkeypatch.setattr(Monitor, "remaining_s", lambda self: -1.0 if is_verifying else 60.0)
    result = plan(atlas(tool_at([0.55, 0.3, 1.2])))
    assert result.verdict is Verdict.TIME_LIMIT
    assert "during 'certificate'" in result.explanation[0]
    assert result.motion is is_verifying[0]
    assert result.certificate is None


def test_a_late_plan_has_no_motion_where_that_takes_longer_than_there_is(late_after_an_attempt, monkeypatch):
    monkeypatch.setattr(planner, "GRACE_S", 0.0)
    result = plan(atlas(tool_at([0.55, 0.3, 1.2])))
    assert result.verdict is Verdict.TIME_LIMIT
    assert result.motion is None
    assert result.certificate is None


def test_a_start_outside_the_margin_settles_first():
    result = plan(atlas(tool_at([0.45, 0.3, 1.1], position_tolerance_m=0.01), obstacles=(), balance_margin_m=0.128))
    assert result.motion.phases[0].name == "settle"
    assert result.verdict is Verdict.CERTIFIED, result.explanation


def test_a_cancelled_plan_says_when_and_a_late_one_that_time_is_up():
    steps = []
    result = plan(
        atlas(tool_at([0.6, 0.2, 1.15])),
        on_progress=lambda step, fraction: steps.append(step),
        should_stop=lambda: "goal pose" in steps,
    )
    assert result.verdict is Verdict.CANCELLED
    assert "cancelled during" in result.explanation[0]
    late = plan(atlas(tool_at([0.6, 0.2, 1.15]), time_limit_s=1e-3), clock=CountingClock(1e-3))
    assert late.verdict is Verdict.TIME_LIMIT
    assert "0.001 s" in late.explanation[0]


def test_equal_requests_get_equal_motions():
    request = atlas(tool_at([0.55, 0.3, 1.2]))
    first, second = plan(request), plan(request)
    np.testing.assert_array_equal(first.motion.curve.positions, second.motion.curve.positions)


def test_the_panda_of_others_reaches_among_boxes(shared_data):
    folder = shared_data / "robots" / "panda"
    start = {"panda_joint2": -0.785, "panda_joint4": -2.356, "panda_joint6": 1.571, "panda_joint7": 0.785}
    result = plan(
        parse_request(
            {
                "robot": {"urdf": str(folder / "panda.urdf"), "package_dirs": [str(folder)]},
                "start": {"joints": start},
                "scene": {
                    "obstacles": [
                        {"name": "table", "type": "box", "size": [0.8, 1.2, 0.05], "position": [0.75, 0.0, 0.1]},
                        {"name": "post", "type": "box", "size": [0.06, 0.06, 0.8], "position": [0.45, 0.25, 0.5]},
                    ]
                },
                "goal": {
                    "poses": [
                        {
                            "link": "panda_hand",
                            "position": [0.45, 0.45, 0.4],
                            "quaternion_wxyz": [0, 1, 0, 0],
                            "free_axis": "z",
                        }
                    ]
                },
            }
        )
    )
    assert result.verdict is Verdict.CERTIFIED, result.explanation


def test_the_drcsim_atlas_of_others_reaches_over_a_table(shared_data):
    folder = shared_data / "robots" / "atlas_drcsim_v5_simple"
    legs = {f"{side}_leg_{joint}": angle for side in "lr" for joint, angle in
            (("kny", 0.4), ("hpy", -0.2), ("aky", -0.2))}  # fmt: skip
    result = plan(
        parse_request(
            {
                "robot": {"urdf": str(folder / "atlas_drcsim_v5_simple.urdf"), "root": "floating"},
                "start": {
                    "base": {"position": [0.0, 0.0, 0.9302]},
                    "joints": {"l_arm_shx": -1.3, "r_arm_shx": 1.3, **legs},
                },
                "scene": {
                    "obstacles": [
                        {"name": "table", "type": "box", "size": [0.5, 1.2, 0.05], "position": [0.85, 0.0, 0.8]}
                    ]
                },
                "goal": {"poses": [{"link": "l_hand", "position": [0.6, 0.2, 1.15]}]},
                "options": {"feet": ["l_foot", "r_foot"]},
            }
        )
    )
    assert result.verdict is Verdict.CERTIFIED, result.explanation


def small_arm(folder, goal: dict[str, float], obstacles: list[dict]) -> PlanRequest:
    """An arm of three joints, 0.6 m long, that turns in a horizontal plane."""
    urdf = write_planar_arm(folder, 3, 0.2, 0.04, limit=3.0)
    return parse_request(
        {
            "robot": {"urdf": str(urdf)},
            "scene": {"obstacles": obstacles, "floor": False},
            "start": {"joints": {"j0": -1.0}},
            "goal": {"joints": goal},
        }
    )


def block(name: str, position: list[float]) -> dict:
    return {"name": name, "type": "box", "size": [0.1, 0.1, 0.1], "position": position}


def test_a_goal_nearer_than_the_margin_is_still_reached(tmp_path):
    # the arm ends along +x; the block's near face is 8 mm beside its outer link, the margin aimed at is 20 mm
    goal = {"j0": 0.0, "j1": 0.0, "j2": 0.0}
    result = plan(small_arm(tmp_path, goal, [block("block", [0.5, 0.02 + 0.008 + 0.05, 0.0])]))
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    assert 0.0 < result.certificate.min_clearance_m <= 0.008 + 1e-6


def test_a_goal_in_collision_is_infeasible_and_names_pair_and_depth(tmp_path):
    goal = {"j0": 0.0, "j1": 0.0, "j2": 0.0}
    result = plan(small_arm(tmp_path, goal, [block("block", [0.5, 0.06, 0.0])]))
    assert result.verdict is Verdict.INFEASIBLE
    assert result.explanation == ("the goal is in collision: l2 is 10 mm inside block (obstacle)",)


def test_a_robot_without_masses_is_written_and_has_no_centre_of_mass(tmp_path):
    result = plan(small_arm(tmp_path, {"j0": 0.5, "j1": 0.0, "j2": 0.0}, []))
    written = Stranger(write_undrawn(result, tmp_path / "out")).data
    assert set(written["com"]) == {None}
    assert len(written["com"]) == len(written["trajectory"]["times"])


@pytest.mark.parametrize(("starts", "tried"), [(1, 1), (2, 2), (16, 4)])
def test_options_starts_limits_the_guesses_of_a_pose(tmp_path, starts, tried):
    urdf = write_planar_arm(tmp_path, 3, 0.4, 0.05, 3.0)
    data = {"robot": {"urdf": str(urdf)}, "goal": {"joints": {"j0": 1.0}}, "options": {"starts": starts}}
    monitor = Monitor(60.0)
    solver = planner._make_solver(prepare(parse_request(data)), monitor, None)
    goal = Goal.of(solver.body, GoalRequest(poses=(PoseGoalRequest("l2", (9.0, 0.0, 0.0)),)))
    seeds = [(str(k), solver.body.nominal + 0.1 * k) for k in range(6)]
    assert not find_pose(solver.pose_problem("goal pose", goal.constraints(0)), seeds).is_feasible
    assert monitor.count_attempts("goal pose") == tried


def _body_and_goal(position: list[float]) -> tuple[WholeBody, Goal]:
    setup = prepare(atlas(tool_at(position)))
    body = WholeBody.standing(setup.robot, setup.scene, setup.start, setup.contacts, Aims())
    assert setup.request.goal is not None
    return body, Goal.of(body, setup.request.goal)


def test_a_posture_brought_to_the_goal_has_its_feet_and_tool_in_place_and_is_balanced():
    body, goal = _body_and_goal([0.55, 0.3, 1.2])
    ((_, q),) = bring_to_goal(body, goal)
    placed = locate_links(body.engine, q, ["l_tool", *(foot.link for foot in body.planted)])
    np.testing.assert_allclose(placed["l_tool"][:3, 3], [0.55, 0.3, 1.2], atol=1e-3)
    for foot in body.planted:
        np.testing.assert_allclose(placed[foot.link], foot.pose_world_link, atol=1e-3)
    com = body.engine(q[None]).com[0, :2]
    np.testing.assert_allclose(com, body.polygon.vertices.mean(axis=0), atol=1e-3)
    assert np.all((q >= body.robot.lower) & (q <= body.robot.upper))


def test_no_posture_is_brought_to_a_goal_out_of_reach():
    assert list(bring_to_goal(*_body_and_goal([3.0, 0.0, 1.0]))) == []
