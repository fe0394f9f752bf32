"""Carriers of movable objects: where these are in each phase, and proofs of grips and of rest, worked out by hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from benchmarks.attack.gantry_files import pick_place_request, write_gantry
from costs.primitive import Primitive
from costs.robot import LinkBody, RobotError, load_robot
from costs.robot.carried import PlacedObject, with_objects
from costs.robot.shapes import box, cylinder
from costs.scene import ConvexPiece
from service.planner import plan
from service.request.file import parse_request
from service.verify import (
    Carrier,
    Grip,
    Motion,
    Phase,
    VerifyError,
    measure_rests,
    place_frames,
    split_motion,
    verify,
)
from service.verify.carrying.grasp import ARM_M, GripBalance, Pad
from service.verify.carrying.resting import measure_rest_margin
from service.verify.carrying.stacks import RestingObject

FRICTION, GRIP_N = 0.4, 50.0
GRIP = Grip(("left", "right"), GRIP_N, FRICTION)
SPOTS = 0.01 * np.array([[x, 0.0, z] for x in (-1.0, 1.0) for z in (-1.0, 1.0)])
PADS = tuple(
    Pad(finger, GRIP, 0.0, np.array([0.0, side, 0.0]), SPOTS - np.array([0.0, 0.03 * side, 0.0]))
    for finger, side in (("left", 1.0), ("right", -1.0))
)
ROUND = 1.0 / np.cos(np.pi / 8.0)  # by which a pyramid of eight sides inside a cone is weaker


@pytest.fixture(scope="module")
def moved(tmp_path_factory: pytest.TempPathFactory) -> Motion:
    """A block that a gantry moves from one side of a table to the other."""
    urdf = write_gantry(tmp_path_factory.mktemp("gantry"))
    result = plan(parse_request(pick_place_request(urdf)))
    assert result.verdict.value == "CERTIFIED", result.explanation
    assert result.motion is not None
    return result.motion


def list_failed(motion: Motion) -> set[str]:
    return {check.name for check in verify(motion).checks if not check.ok}


def change_carriers(motion: Motion, names: set[str], change: Callable[[Phase], tuple[Carrier, ...]]) -> Motion:
    phases = (replace(p, carriers=change(p)) if p.name in names else p for p in motion.phases)
    return replace(motion, phases=tuple(phases))


def test_two_pads_need_half_the_weight_over_the_friction() -> None:
    share = GripBalance(PADS, np.zeros(3)).find_share(np.array([0.0, 0.0, 20.0, 0.0, 0.0, 0.0]))
    least = 20.0 / (2.0 * FRICTION * GRIP_N)
    assert least - 1e-9 <= share <= ROUND * least + 1e-9


def test_a_weight_beside_the_pads_needs_torsion_and_more_force() -> None:
    weight = np.array([0.0, 0.0, 10.0, 0.0, 0.0, 0.0])
    hanging = np.array([0.0, 0.0, 10.0, 0.0, 0.5, 0.0])  # 5 cm beside the line between the pads
    balance = GripBalance(PADS, np.zeros(3))
    # Spots 14 mm from the middle resist at most 2 F mu 14 mm = 0.57 N m, of which 0.5 is needed besides the weight.
    assert balance.find_share(weight) < 0.3
    assert balance.find_share(hanging) > 0.5 / (2.0 * FRICTION * GRIP_N * 0.01 * np.sqrt(2.0))


def test_nothing_holds_without_friction() -> None:
    slippery = tuple(replace(pad, grip=replace(GRIP, friction=0.0)) for pad in PADS)
    assert GripBalance(slippery, np.zeros(3)).find_share(np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])) == np.inf


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_shares_are_those_of_another_solver_whatever_was_asked_before(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pads = tuple(replace(pad, points=pad.points + 1e-3 * rng.normal(size=pad.points.shape)) for pad in PADS)
    balance = GripBalance(pads, np.zeros(3))
    edges, presses = balance._edges, balance._presses
    caps = np.hstack([presses, -np.ones((len(presses), 1))])
    for wrench in rng.normal(size=(4, 6)) * [20.0, 20.0, 20.0, 0.3, 0.3, 0.3]:
        found = linprog(
            np.append(np.zeros(edges.shape[1]), 1.0),
            A_ub=caps,
            b_ub=np.zeros(len(caps)),
            A_eq=np.hstack([edges, np.zeros((6, 1))]),
            b_eq=np.concatenate([wrench[:3], wrench[3:] / ARM_M]),
        )
        wanted = found.x[-1] if found.status == 0 else np.inf
        assert balance.find_share(wrench) == pytest.approx(wanted, rel=1e-6, abs=1e-9)


forces = st.lists(st.floats(-10.0, 10.0), min_size=3, max_size=3).map(np.array)


@settings(deadline=None, max_examples=30)
@given(forces, forces)
def test_the_share_of_a_sum_is_at_most_the_sum_of_shares(first: np.ndarray, second: np.ndarray) -> None:
    """So that a bound between two poses follows from those at both."""
    balance = GripBalance(PADS, np.zeros(3))
    a, b, both = (balance.find_share(np.concatenate([f, np.zeros(3)])) for f in (first, second, first + second))
    assert both <= a + b + 1e-7


def lift(points: np.ndarray, x: float, z: float) -> np.ndarray:
    return points + np.array([x, 0.0, z])


def rest(centre: np.ndarray, *pieces: ConvexPiece) -> float:
    vertices = lift(box(np.array([0.1, 0.1, 0.1])), 0.0, 0.05)
    return measure_rest_margin(LinkBody("cube", "cube", 0, vertices, vertices), centre, pieces)[0]


def test_a_cube_rests_as_far_as_its_centre_is_inside_what_it_stands_on() -> None:
    middle = np.array([0.0, 0.0, 0.05])
    ledge = ConvexPiece("ledge", lift(box(np.array([1.0, 1.0, 0.1])), -0.48, -0.05))  # ends 2 cm beyond the middle
    beside = ConvexPiece("ledge", lift(box(np.array([1.0, 1.0, 0.1])), -0.52, -0.05))  # 2 cm before it
    assert rest(middle, ledge) == pytest.approx(0.02, abs=1e-6)
    assert rest(middle, beside) < 0.0
    assert rest(middle) == -np.inf
    far = ConvexPiece("far", lift(ledge.vertices, 0.0, -0.01))
    assert rest(middle, far) == -np.inf


def test_a_can_stands_and_does_not_rest_on_its_side() -> None:
    floor = ConvexPiece("floor", lift(box(np.array([1.0, 1.0, 0.1])), 0.0, -0.05))
    for turned, height, holds in (
        (np.eye(3), 0.05, True),
        (np.array([[0, 0, 1.0], [0, 1, 0], [-1, 0, 0]]), 0.03, False),
    ):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turned, [0.0, 0.0, height]
        vertices = cylinder(0.03, 0.1) @ turned.T + pose[:3, 3]
        can = LinkBody("can", "can", 0, vertices, vertices, Primitive("cylinder", 0.03, 0.1, pose))
        margin, names = measure_rest_margin(can, pose[:3, 3], [floor])
        assert names == ("floor",)
        assert (margin > 0.02) == holds
        assert holds or margin < 1e-6


def test_what_lies_on_a_cube_does_not_hold_it_worse() -> None:
    ledge = ConvexPiece("ledge", lift(box(np.array([1.0, 1.0, 0.1])), -0.48, -0.05))
    lid = ConvexPiece("lid", lift(box(np.array([0.1, 0.1, 0.02])), 0.0, 0.11))
    assert rest(np.array([0.0, 0.0, 0.05]), ledge, lid) >= 0.02 - 1e-6


def test_what_a_link_carries_adds_to_the_mass_and_what_the_world_carries_does_not(moved: Motion) -> None:
    (item,) = moved.objects
    robot = moved.robot
    own, still, held = (
        sum(inertia.mass for inertia in made.model.inertias)
        for made in (
            robot,
            with_objects(robot, [PlacedObject(item, None, item.start)]),
            with_objects(robot, [PlacedObject(item, "hand", np.eye(4))]),
        )
    )
    assert still == own
    assert held == pytest.approx(own + item.inertia.mass)


def test_an_object_does_not_move_where_its_carrier_changes(moved: Motion) -> None:
    parts = split_motion(moved)
    for phase, before, after in zip(moved.phases[1:], parts[:-1], parts[1:], strict=True):
        q = moved.curve(np.array([phase.first]))[0]
        poses = [place_frames(part.robot, q, ["block"])["block"] for part in (before, after)]
        assert np.abs(poses[0] - poses[1]).max() < 1e-12
    first, last = (
        place_frames(part.robot, q, ["block"])["block"][:3, 3]
        for part, q in ((parts[0], moved.curve.positions[0]), (parts[-1], moved.curve.positions[-1]))
    )
    assert first == pytest.approx([0.1, -0.2, 0.44], abs=1e-12)
    assert last == pytest.approx([-0.1, 0.2, 0.44], abs=1e-3)


def test_a_hand_that_lets_go_in_the_air_is_refuted(moved: Motion) -> None:
    dropped = change_carriers(moved, {"carry", "lower"}, lambda phase: (Carrier("block"),))
    assert "rests.carry.block" in list_failed(dropped)


def test_an_object_that_is_heavier_than_the_grip_is_refuted(moved: Motion) -> None:
    (item,) = moved.objects
    heavy = replace(moved, objects=(replace(item, inertia=replace(item.inertia, mass=8.0)),))
    assert {"carried.lift.block", "swung.lift.block"} <= list_failed(heavy)


def test_a_grasp_beside_the_object_is_refuted(moved: Motion) -> None:
    (item,) = moved.objects
    start = item.start.copy()
    start[0, 3] -= 0.004
    failed = list_failed(replace(moved, objects=(replace(item, start=start),)))
    assert "grip.lift.block" in failed or "clearance" in failed


def test_fingers_that_move_while_they_hold_are_refuted(moved: Motion) -> None:
    column = moved.robot.joint_names.index("grip_1")
    carry = next(phase for phase in moved.phases if phase.name == "carry")
    positions = moved.curve.positions.copy()
    inside = (moved.curve.knots > carry.first) & (moved.curve.knots < carry.last)
    positions[inside, column] += 2e-3
    loose = replace(moved, curve=replace(moved.curve, positions=positions))
    assert "grip.carry.block" in list_failed(loose)


def test_a_phase_says_who_carries_every_object(moved: Motion) -> None:
    silent = change_carriers(moved, {"carry"}, lambda phase: ())
    with pytest.raises(VerifyError, match="phase 'carry' says who carries nothing; expected each of block once"):
        verify(silent)
    unknown = change_carriers(moved, {"carry"}, lambda phase: (Carrier("block", "claw", (GRIP,)),))
    with pytest.raises(VerifyError, match="'claw', which carries 'block' in phase 'carry', is unknown"):
        verify(unknown)
    bare = change_carriers(moved, {"carry"}, lambda phase: (Carrier("block", "hand"),))
    with pytest.raises(VerifyError, match="'hand' carries 'block' without a grip"):
        verify(bare)


def test_an_object_has_a_name_of_its_own(tmp_path: Path, moved: Motion) -> None:
    robot = load_robot(urdf=write_gantry(tmp_path))
    (item,) = moved.objects
    with pytest.raises(RobotError, match="object 'hand': the name is in use by gantry"):
        with_objects(robot, [PlacedObject(replace(item, name="hand"), None, item.start)])


def test_walls_about_a_peg_do_not_hold_it_up_by_squeezing_it() -> None:
    play, peg = 0.002, lift(box(np.array([0.04, 0.04, 0.14])), 0.0, 0.08)
    body, centre = LinkBody("peg", "peg", 0, peg, peg), np.array([0.0, 0.0, 0.08])
    thick, long = np.array([0.04, 0.12, 0.06]), np.array([0.04, 0.04, 0.06])
    off = 0.04 + 0.5 * play
    walls = [ConvexPiece(f"wall {x}", lift(box(thick), x, 0.04)) for x in (off, -off)]
    walls += [ConvexPiece(f"wall {y}", box(long) + np.array([0.0, y, 0.04])) for y in (off, -off)]
    margin, names = measure_rest_margin(body, centre, walls)
    assert margin == -np.inf
    assert len(names) == 4
    bottom = ConvexPiece("bottom", lift(box(np.array([0.2, 0.2, 0.02])), 0.0, 0.0))
    assert measure_rest_margin(body, centre, [*walls, bottom])[0] > 0.0


offsets = st.lists(st.floats(-0.03, 0.03), min_size=2, max_size=3)


@settings(deadline=None, max_examples=30)
@given(offsets, st.floats(0.2, 5.0))
def test_each_cube_of_a_tower_holds_those_above_it(offs: list[float], mass: float) -> None:
    """The weight of a cube and of all above it acts at their common centre, inside what the cube stands on."""
    floor = ConvexPiece("floor", lift(box(np.array([1.0, 1.0, 0.1])), 0.0, -0.05))
    at, masses = np.cumsum([0.0, *offs]), [1.0, mass, 1.0, 1.0][: len(offs) + 1]
    tower = []
    for k, x in enumerate(at):
        vertices, centre = lift(box(np.array([0.1, 0.1, 0.1])), x, 0.05 + 0.1 * k), np.array([x, 0.0, 0.05 + 0.1 * k])
        tower.append(RestingObject(LinkBody(f"cube {k}", "", 0, vertices, vertices), masses[k], centre))
    rests = measure_rests(tower[::-1], [floor])
    for k in range(len(at)):
        common = np.average(at[k:], weights=masses[k:])
        low, high = at[k] - 0.05, at[k] + 0.05
        if k:
            low, high = max(low, at[k - 1] - 0.05), min(high, at[k - 1] + 0.05)
        wanted = min(common - low, high - common)
        margin = rests[f"cube {k}"].margin
        assert rests[f"cube {k}"].names == (f"cube {k - 1}" if k else "floor",)
        assert margin == pytest.approx(wanted, abs=1e-6) if wanted > 0.0 else margin <= 1e-6


def test_a_plank_on_two_posts_may_bear_on_either_alone() -> None:
    """Nobody knows how two posts share a weight: each has to stand with all of it at its worst place."""
    floor = ConvexPiece("floor", lift(box(np.array([1.0, 1.0, 0.1])), 0.0, -0.05))

    def rest_of_posts(width: float) -> float:
        posts = []
        for k, x in enumerate((-0.2, 0.2)):
            vertices = lift(box(np.array([width, width, 0.2])), x, 0.1)
            posts.append(RestingObject(LinkBody(f"post {k}", "", 0, vertices, vertices), 1.0, np.array([x, 0.0, 0.1])))
        vertices = lift(box(np.array([0.36, 0.1, 0.02])), 0.0, 0.21)
        plank = RestingObject(LinkBody("plank", "", 0, vertices, vertices), 8.0, np.array([0.0, 0.0, 0.21]))
        rests = measure_rests([plank, *posts], [floor])
        assert rests["plank"].margin > 0.03
        assert set(rests["plank"].names) == {"post 0", "post 1"}
        return min(rests["post 0"].margin, rests["post 1"].margin)

    assert rest_of_posts(0.1) == pytest.approx(0.05 * (1.0 - 8.0 / 9.0), abs=1e-6)  # the weight at a corner of its top
