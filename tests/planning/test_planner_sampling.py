"""The sampling planner's starts, and what they are good for: problems that no straight start leads around."""

import json
import sys
from dataclasses import replace
from itertools import pairwise

import numpy as np
from planar_arm import write_planar_arm

from costs.kinematics import locate_links
from costs.robot import load_robot
from costs.scene import ConvexPiece, Scene
from service.body.aims import Aims
from service.body.paths import resample_path
from service.body.sampling import HeldProblem, SamplingProblem, Tree, free_coordinates, sample_path
from service.body.whole_body import WholeBody
from service.planner import plan
from service.request.file import parse_request
from service.result.result import Verdict

CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])


def arm(tmp_path) -> WholeBody:
    """Two links of 0.3 m that turn in a horizontal plane, with a post between their start and their end."""
    robot = load_robot(urdf=write_planar_arm(tmp_path, 2, 0.3, 0.03, limit=2.9))
    post = ConvexPiece("post", 0.1 * CORNERS + [0.5, 0.0, 0.0])
    return WholeBody.standing(robot, Scene((post,)), np.array([-0.9, 0.0]), (), Aims())


def problem_of(body: WholeBody) -> SamplingProblem:
    end = np.array([0.9, 0.0])
    checker = body.make_pose_checker([body.nominal, end])
    return SamplingProblem(body, checker, body.nominal, end, free_coordinates(body))


def test_a_sampled_path_goes_around_and_keeps_clear_when_sampled_densely(tmp_path):
    body = arm(tmp_path)
    problem = problem_of(body)
    path = sample_path(problem, Tree(seed=0, most_checks=3000))
    np.testing.assert_array_equal(path[0], problem.start)
    np.testing.assert_array_equal(path[-1], problem.end)
    checker = body.make_checker()
    dense = np.concatenate([a + (b - a) * np.linspace(0.0, 1.0, 60)[:, None] for a, b in pairwise(path)])
    for q in dense:
        contacts = checker(body.engine(q[None]))
        assert contacts.distance.min(initial=1.0) > 0.0
    straight = np.linspace(problem.start, problem.end, 30)
    assert any((checker(body.engine(q[None])).distance < 0.0).any() for q in straight)


def test_equal_seeds_give_equal_paths(tmp_path):
    problem = problem_of(arm(tmp_path))
    first, second = (sample_path(problem, Tree(seed=3, most_checks=3000)) for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_without_the_library_no_path_is_sampled_and_a_note_says_so(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "ompl", None)  # as where it is not installed
    body = arm(tmp_path)
    assert sample_path(problem_of(body), Tree(seed=0, most_checks=3000)) is None
    box = {"name": "post", "type": "box", "size": [0.1, 0.1, 0.1], "position": [0.5, 0.0, 0.0]}
    joints = list(body.robot.joint_names)
    request = parse_request({
        "robot": {"urdf": str(next(tmp_path.rglob("*.urdf")))},
        "scene": {"obstacles": [box], "floor": False},
        "start": {"joints": {joints[0]: -0.9}},
        "goal": {"joints": {joints[0]: 0.9}},
        "options": {"starts": 6},
    })  # fmt: skip
    result = plan(request)
    assert not result.found_from.startswith("path of")
    assert any(note.startswith("OMPL is not installed: no path is sampled") for note in result.notes)


def test_a_way_that_is_closed_is_not_found_within_its_checks(tmp_path):
    body = arm(tmp_path)
    # the upper link can pass neither the post ahead nor the one behind
    ring = [ConvexPiece(name, 0.1 * CORNERS + [x, 0.0, 0.0]) for name, x in (("ahead", 0.2), ("behind", -0.2))]
    closed = WholeBody.standing(body.robot, Scene(tuple(ring)), body.nominal, (), Aims())
    assert sample_path(problem_of(closed), Tree(seed=0, most_checks=1000)) is None


def test_waypoints_along_a_polyline_hold_its_corners():
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.3], [0.2, 2.0]])
    waypoints = resample_path(corners, 12)
    assert len(waypoints) == 12
    for corner in corners:
        assert np.abs(waypoints - corner).max(axis=1).min() < 1e-12


def test_legs_and_base_of_a_standing_robot_are_not_free():
    robot = load_robot("atlas")
    body = WholeBody.standing(robot, Scene(), robot.postures["stand"], robot.link_groups["feet"], Aims())
    free = [robot.joint_names[i] for i in free_coordinates(body)]
    assert not any(name.startswith("base_") or "_leg_" in name for name in free)
    assert "back_bkz" in free
    assert "l_arm_shz" in free


def standing_behind_a_post() -> tuple[WholeBody, np.ndarray]:
    """Atlas on both feet, and a configuration on them with another base and its left arm behind a post."""
    robot = load_robot("atlas")
    start = robot.postures["reach_ready"]
    post = ConvexPiece("post", CORNERS * [0.08, 0.08, 2.0] + [0.55, 0.42, 1.0])
    body = WholeBody.standing(robot, Scene((post,)), start, robot.link_groups["feet"], Aims())
    end = start.copy()
    end[[1, 2]] += [0.01, -0.03]
    end[robot.joint_names.index("l_arm_shz")] += 0.9
    return body, body.project_onto_holds(np.stack([start, end]))[1]


def measure_feet(body: WholeBody, q: np.ndarray) -> float:
    """Return how far the corners of the soles are from where they were planted [m]."""
    poses = locate_links(body.engine, q, [foot.link for foot in body.planted])
    return max(
        float(np.abs(foot.sole @ poses[foot.link][:3, :3].T + poses[foot.link][:3, 3] - foot.points).max())
        for foot in body.planted
    )


def test_standing_legs_follow_a_base_that_is_drawn():
    body, end = standing_behind_a_post()
    problem = HeldProblem.between(body, body.make_pose_checker([body.nominal, end]), body.nominal, end)
    first, last = problem.ends
    low, high = problem.limit_draws(0.8)
    draws = np.random.default_rng(0).uniform(low, high, (30, len(low)))
    placed = problem.place(np.stack([first, last, *draws]))
    np.testing.assert_allclose(placed[:2], [body.nominal, end], atol=1e-4)
    off = np.array([measure_feet(body, q) for q in placed])
    assert (off[2:] < 1e-3).any()
    assert (off[2:] > 5e-3).any()
    for pose, far in zip(draws, off[2:], strict=True):
        if far > 5e-3:  # the legs do not reach so far
            assert not problem.is_clear(pose[None])
    # what leads is where it was drawn, base and arms
    np.testing.assert_allclose(placed[2:, problem.free], draws / problem._scale, rtol=0.0, atol=1e-9)


def test_a_standing_robot_is_led_around_a_post_on_its_feet():
    body, end = standing_behind_a_post()
    problem = HeldProblem.between(body, body.make_pose_checker([body.nominal, end]), body.nominal, end)
    first, last = problem.ends
    assert not problem.is_clear(problem.interpolate_edge(first, last))
    path = sample_path(problem, Tree(seed=0, most_checks=2000, beyond=0.8, edge_step=0.05))
    assert path is not None
    np.testing.assert_array_equal(path[[0, -1]], [body.nominal, end])
    assert max(measure_feet(body, q) for q in path) < 2e-3
    polygon = body.polygon
    assert polygon is not None
    assert polygon.margin(body.engine.place(path).com[:, :2]).min() > body.aims.balance_margin
    checker = body.make_checker()
    assert min(checker(body.engine(q[None])).distance.min(initial=1.0) for q in path) > 0.0
    shorter = problem.shorten(path, np.random.default_rng(1))
    assert max(measure_feet(body, q) for q in shorter) < 2e-3


def motion_bench_maker(folder):
    """Requests of all problems in the folder."""
    for file in sorted(folder.glob("*.json")):
        data = json.loads(file.read_text())
        for problem in data["problems"]:
            obstacles = []
            for index, obstacle in enumerate(problem["obstacles"]):
                x, y, z, w = obstacle["quat_xyzw"]
                sizes = {key: obstacle[key] for key in ("size", "radius") if key in obstacle}
                if obstacle["type"] == "cylinder":
                    sizes["height"] = obstacle["length"] if "length" in obstacle else obstacle["height"]
                obstacles.append(
                    {
                        "name": f"{obstacle['name']}#{index}",
                        "type": obstacle["type"],
                        "position": obstacle["position"],
                        "quaternion_wxyz": [w, x, y, z],
                        **sizes,
                    }
                )
            robot = folder / "panda_bench" / "panda"
            yield {
                "robot": {
                    "urdf": str(robot.with_suffix(".urdf")),
                    "srdf": str(robot.with_suffix(".srdf")),
                    "package_dirs": [str(folder)],
                },
                "start": {"joints": dict(zip(data["joints"], problem["start"], strict=True))},
                "scene": {"obstacles": obstacles},
                "goal": {"joints": dict(zip(data["joints"], problem["goal"], strict=True))},
            }


def test_every_third_motion_bench_maker_problem_at_hand_is_certified(shared_data):
    problems = list(motion_bench_maker(shared_data / "mbm_panda"))
    assert len(problems) == 42
    assert {plan(parse_request(request)).verdict for request in problems[::3]} == {Verdict.CERTIFIED}


def test_a_result_names_the_start_it_was_found_from(tmp_path):
    request = {
        "robot": {"urdf": str(write_planar_arm(tmp_path, 2, 0.3, 0.03, limit=2.9))},
        "start": {"joints": {"j0": -0.9, "j1": 0.0}},
        "scene": {"obstacles": [{"name": "post", "type": "box", "size": [0.1] * 3, "position": [0.5, 0.0, 0.0]}]},
        "goal": {"joints": {"j0": 0.9, "j1": 0.0}},
    }
    around = plan(parse_request(request))
    assert around.verdict is Verdict.CERTIFIED
    free = plan(parse_request({**request, "scene": {}}))
    assert free.found_from == "straight line"
    assert plan(parse_request({**request, "options": {"starts": 1}})).found_from == "straight line"
    assert around.found_from


def test_a_gap_narrower_than_the_usual_clearance_is_passed_with_less(tmp_path):
    body = arm(tmp_path)
    reach = max(np.linalg.norm(part.vertices[:, :2], axis=1).max() for part in body.robot.bodies if part.link == "l0")
    post = ConvexPiece("post", 0.1 * CORNERS + [reach + 0.05 + 0.007, 0.0, 0.0])  # 4 mm beside the elbow
    narrow = replace(body, scene=Scene((post,)))
    tree = Tree(seed=0, most_checks=3000, planner="RRTConnect")
    assert sample_path(problem_of(narrow), tree) is None
    path = sample_path(problem_of(replace(narrow, sampled_clearance=2e-3)), replace(tree, edge_step=0.05))
    assert path is not None
    assert np.abs(path[:, 1]).max() > 1.0  # folded


def test_coordinates_are_drawn_no_farther_beyond_the_ends_than_the_tree_says(tmp_path):
    problem = problem_of(arm(tmp_path))
    tree = Tree(seed=1, most_checks=3000, planner="RRTConnect")
    assert sample_path(problem, replace(tree, beyond=0.3)) is None  # the way around folds the arm
    path = sample_path(problem, replace(tree, beyond=2.0))
    assert np.abs(path).max() <= 2.9
    assert sample_path(problem, replace(tree, beyond=np.inf)) is not None


def test_links_that_an_srdf_leaves_out_keep_apart_where_they_would_meet(tmp_path):
    urdf = write_planar_arm(tmp_path, 3, 0.3, 0.03, limit=2.9)
    srdf = tmp_path / "arm.srdf"
    left_out = (("l0", "l1", "Adjacent"), ("l1", "l2", "Adjacent"), ("l0", "l2", "Never"))
    rows = "".join(f'<disable_collisions link1="{a}" link2="{b}" reason="{why}"/>' for a, b, why in left_out)
    srdf.write_text(f'<robot name="arm">{rows}</robot>')
    request = parse_request(
        {
            "robot": {"urdf": str(urdf), "srdf": str(srdf)},
            "start": {"joints": {"j0": 0.0, "j1": 1.7, "j2": 2.45}},
            "goal": {"joints": {"j0": 0.0, "j1": 2.6, "j2": 1.55}},
            "scene": {"obstacles": [{"name": "box", "type": "box", "size": [0.1] * 3, "position": [0.5, -0.5, 0.0]}]},
            "options": {"timed": False},
        }
    )
    result = plan(request)
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    pair = next(item for item in result.certificate.coverage.left_out if item.pair == ("l0", "l2"))
    assert pair.reason == "srdf (Never)"
    assert pair.s is None  # proven apart
