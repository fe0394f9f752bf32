"""Fits about a click: planes there, places, best fits with what speaks against them, and their rivals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from perception import CONFIDENT, Detection, View, detect_at, make_view
from perception.detect.engine.click import fit_at, propose
from perception.detect.engine.doubts import list_doubts
from perception.detect.engine.hits import as_detection
from perception.detect.engine.primitives import Box, Capsule, Cylinder, Primitive, Torus, nearest, nearest_part
from perception.detect.engine.refine import Hypotheses
from perception.detect.engine.search import LED, Site, search
from perception.detect.engine.surroundings import Surroundings
from perception.detect.engine.template import Looseness, Part, Size, Starts, Template, columns
from perception.detect.engine.templates.lever import LEVER
from perception.detect.engine.templates.lever_on_pipe import LEVER_ON_PIPE
from perception.detect.shared.overlap import offer_alternatives
from perception.sightlines import sight_index
from perception.simulate import Mesh, Pose, Scanner, box, cylinder, scan
from perception.simulate.scenes.loose import Drill

TOP = 0.8
SENSOR = Pose((0.1, 0.0, 1.5), pitch=0.7)
SCANNER = Scanner(n_beams=541, fan_deg=160.0, n_lines=70)
DRILL = Drill((0.8, 0.1, TOP), np.radians(70.0))


def view_of(*meshes: Mesh) -> View:
    table = [box((-5.0, -5.0, -0.1), (5.0, 5.0, 0.0)), box((0.5, -0.6, TOP - 0.03), (1.2, 0.6, TOP))]
    return make_view(scan([*table, *meshes], SENSOR, SCANNER, 0))


@pytest.fixture(scope="module")
def drills() -> tuple[np.ndarray, list[Detection]]:
    """The true pose of a drill, and the fits about a click 6 cm beside it."""
    built = DRILL.build()
    truth = built.truth[0].pose_world_object
    click = truth[:3, 3] + (0.03, -0.03, 0.04)
    ((_, hits),) = detect_at(("drill",), view_of(*built.meshes), click)
    return truth, hits


def test_a_drill_near_a_click_is_fitted_to_15_mm_and_5_deg(drills: tuple[np.ndarray, list[Detection]]) -> None:
    truth, hits = drills
    assert hits[0].confidence >= CONFIDENT
    assert np.linalg.norm(hits[0].pose_world_object[:3, 3] - truth[:3, 3]) < 0.015
    assert hits[0].pose_world_object[:3, 0] @ truth[:3, 0] > np.cos(np.radians(5.0))


def test_few_fits_are_returned_best_first_and_the_worse_ones_say_what_is_against_them(
    drills: tuple[np.ndarray, list[Detection]],
) -> None:
    _, hits = drills
    confidences = [hit.confidence for hit in hits]
    assert 1 <= len(hits) <= 4
    assert confidences == sorted(confidences, reverse=True)
    assert all(hit.doubts for hit in hits if hit.confidence < 0.3)


def test_fits_on_the_same_points_leave_each_other_what_is_left_of_certainty(
    drills: tuple[np.ndarray, list[Detection]],
) -> None:
    _, hits = drills
    best = hits[0]
    back = replace(best, confidence=0.9 * best.confidence)
    aside = replace(back, points=best.points + 1.0)
    assert offer_alternatives([back, best, aside], []) == [best, aside, replace(back, confidence=1.0 - best.confidence)]
    assert offer_alternatives([best], [back]) == [best]


@pytest.fixture(scope="module")
def faced() -> tuple[View, np.ndarray]:
    """A lever that points to the sensor's right, 5 cm before a wall ahead; and its pivot."""
    pivot, tip = (0.95, 0.1, 1.0), (0.95, -0.03, 1.0)
    wall = box((1.0, -1.0, 0.0), (1.1, 1.0, 2.0))
    bar, neck = cylinder(pivot, tip, 0.01, 24), cylinder(pivot, (1.0, 0.1, 1.0), 0.01, 24)
    return make_view(scan([wall, bar, neck], Pose((0.0, 0.0, 1.2)), SCANNER, 0)), np.array(pivot)


def test_what_hangs_on_a_face_begins_with_its_z_axis_out_of_the_face(faced: tuple[View, np.ndarray]) -> None:
    view, pivot = faced
    around = Surroundings.of(view.near.points, np.median(view.near.starts, axis=0), pivot)
    sites = propose(LEVER, around)
    assert sites
    for site in sites:
        assert site.mounting is not None
        assert site.begun.rotation[:, :, 2] == pytest.approx(
            np.broadcast_to(site.mounting.frame[2], (len(site.begun), 3)), abs=1e-6
        )


def test_a_lever_near_a_click_is_fitted_and_its_opposite_is_offered_too(faced: tuple[View, np.ndarray]) -> None:
    view, pivot = faced
    ((_, hits),) = detect_at(("lever",), view, pivot + np.array([-0.03, 0.02, 0.05]))
    ways = [hit.pose_world_object[:3, 0] for hit in hits]
    right = [k for k, hit in enumerate(hits) if np.linalg.norm(hit.pose_world_object[:3, 3] - pivot) < 0.015]
    assert any(ways[k] @ (0.0, -1.0, 0.0) > np.cos(np.radians(5.0)) for k in right)
    assert any(way @ (0.0, 1.0, 0.0) > np.cos(np.radians(10.0)) for way in ways)


def test_a_wide_bent_lever_before_a_thick_pipe_is_fitted_with_its_pipe() -> None:
    bend, hub = np.radians(6.0), np.array([1.28, 0.1, 1.2])
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("y", -bend).as_matrix()
    pose[:3, 3] = hub
    parts = [
        box((-0.028, -0.025, -0.03), (0.028, 0.025, 0.28)).place(pose),
        cylinder((1.28, 0.1, 1.2), (1.5, 0.1, 1.2), 0.02, 24),
        cylinder((1.5, 0.1, 0.2), (1.5, 0.1, 2.2), 0.088, 48),
        box((2.4, -2.0, 0.0), (2.5, 2.0, 2.5)),
    ]
    view = make_view(scan(parts, Pose((0.0, 0.0, 1.5)), SCANNER, 0))
    around = Surroundings.of(view.near.points, np.median(view.near.starts, axis=0), hub + np.array([-0.02, 0.03, 0.18]))
    fits = fit_at(LEVER_ON_PIPE, around, sight_index(view.cloud))
    # From straight ahead either end may be the pivot.
    bars = [(fit, fit.hypotheses.place[0] + 0.12 * fit.hypotheses.rotation[0][:, 0] - hub) for fit in fits]
    along = pose[:3, 2]
    right = [fit for fit, way in bars if np.linalg.norm(way - (way @ along) * along) < 0.015]
    right = [fit for fit in right if abs(as_detection(fit).pose_world_object[2, 0]) > np.cos(np.radians(5.0))]
    assert any(as_detection(fit).pose_world_object[0, 2] < -np.cos(np.radians(5.0)) for fit in right)


def test_the_seen_neck_of_a_lever_shows_which_end_is_its_pivot() -> None:
    hub, out = np.array([1.28, 0.0, 1.2]), np.array([-1.0, 0.0, 0.0])
    parts = [
        box((1.268, -0.02, 1.17), (1.292, 0.02, 1.46)),
        cylinder((1.292, 0.0, 1.2), (1.5, 0.0, 1.2), 0.05, 24),
        cylinder((1.5, 0.0, 0.2), (1.5, 0.0, 2.2), 0.07, 48),
        box((2.4, -2.0, 0.0), (2.5, 2.0, 2.5)),
    ]
    view = make_view(scan(parts, Pose((0.5, -0.8, 1.5), yaw=0.8), SCANNER, 0))
    begun = Hypotheses.of(
        np.column_stack([(0.0, 0.0, 1.0), np.cross(out, (0.0, 0.0, 1.0)), out])[None],
        hub[None],
        np.array([[0.25, 0.02, 0.012, 0.03, 0.0, 0.22, 0.07, 0.0, 0.02]]),
        np.array([0.0, 0.0, 1.0]),
    )
    right, turned = search(LEVER_ON_PIPE, [Site(hub, None, begun)], sight_index(view.cloud), effort=LED)[:2]
    assert np.linalg.norm(right.hypotheses.place[0] - hub) < 0.03 < np.linalg.norm(turned.hypotheses.place[0] - hub)
    radii = [LEVER_ON_PIPE.named(fit.hypotheses.sizes)["neck_radius"][0] for fit in (right, turned)]
    # Little of the neck is seen beside its lever, so that its radius stays nearer to the usual one.
    assert radii[0] > 0.03
    assert radii[1] < 0.02


@given(st.floats(-0.2, 0.2), st.floats(-1.5, 1.5))
def test_the_z_axis_of_a_lever_leads_from_its_pipe_however_it_is_bent(bend: float, turn: float) -> None:
    sizes = LEVER_ON_PIPE.named(np.array([[0.2, 0.02, 0.01, 0.02, bend, 0.15, 0.05, turn, 0.02]]))
    axes, pipe = LEVER_ON_PIPE.axes(sizes)[0], LEVER_ON_PIPE.build(sizes)[2].solid
    assert isinstance(pipe, Cylinder)
    assert axes.T @ axes == pytest.approx(np.eye(3), abs=1e-12)
    assert 0.5 * (pipe.first + pipe.last)[0] == pytest.approx(-0.15 * axes[:, 2], abs=1e-12)
    assert (pipe.last - pipe.first)[0] @ axes[:, 2] == pytest.approx(0.0, abs=1e-12)


def test_a_carton_at_a_click_is_no_drill() -> None:
    view = view_of(box((0.75, 0.0, TOP), (0.85, 0.15, TOP + 0.2)))
    ((_, hits),) = detect_at(("drill",), view, np.array([0.76, 0.05, TOP + 0.1]))
    assert all(hit.confidence < CONFIDENT for hit in hits)


@settings(max_examples=20, deadline=None)
@given(st.floats(-1.2, 1.2), st.floats(0.0, 6.2))
def test_a_wall_and_a_table_are_the_planes_about_a_click(lean: float, yaw: float) -> None:
    rng = np.random.default_rng(0)
    turn = Rotation.from_euler("zy", [yaw, 0.3 * lean]).as_matrix()
    wall = np.column_stack([rng.normal(0.0, 0.001, 3000), rng.uniform(-0.4, 0.4, 3000), rng.uniform(0.05, 0.6, 3000)])
    table = np.column_stack([rng.uniform(-0.4, 0.4, (4000, 2)), rng.normal(0.0, 0.001, 4000)])
    click, sensor = np.array([0.05, 0.0, 0.1]), np.array([0.0, 0.0, 3.0]) - 2.0 * turn[:, 0]
    around = Surroundings.of(np.concatenate([wall @ turn.T, table]), sensor, click)
    assert around.supports[0].point[2] == pytest.approx(0.0, abs=0.003)
    assert any(abs(face.frame[2] @ turn[:, 0]) > 0.999 for face in around.faces)
    assert all((sensor - plane.point) @ plane.frame[2] > 0.0 for plane in around.planes)


PARTS: list[Primitive] = [
    Capsule(np.array([[0.0, 0.0, 0.0]]), np.array([[0.1, 0.0, 0.0]]), np.array([0.02])),
    Box(np.array([[0.0, 0.1, 0.0]]), np.array([[0.03, 0.02, 0.05]]), 0.004),
    Cylinder(np.array([[0.0, 0.0, 0.1]]), np.array([[0.0, 0.05, 0.15]]), np.array([0.03])),
    Torus(np.array([0.02]), np.array([0.1]), np.array([0.01])),
]


@given(st.lists(st.tuples(*[st.floats(-0.3, 0.3)] * 3), min_size=1, max_size=8))
def test_the_nearest_part_is_the_one_whose_distance_is_the_least(places: list[tuple[float, float, float]]) -> None:
    at = np.array([places])
    least, number = nearest_part(PARTS, at)
    assert least == pytest.approx(nearest(PARTS, at))
    for i, k in enumerate(number[0]):
        alone = PARTS[k].take(np.zeros(1, dtype=np.int64)).distance(at[:, i : i + 1])
        assert alone[0, 0] == pytest.approx(least[0, i])


def test_what_weighs_most_against_a_hit_is_named_first() -> None:
    weights = {"bias": -3.0, "explained_share": 10.0, "lead": 2.0, "n_hits": 1.0}
    usual = {"explained_share": 0.95, "lead": 0.5, "n_hits": 5.0}
    inputs = {"explained_share": 0.6, "lead": -0.5, "n_hits": 4.9}
    doubts = list_doubts(weights, usual, inputs, {"explained_share": 0.6})
    assert doubts == (
        "40% of the points about it do not lie on it",
        "a box, a cylinder or a solid block explains the rays as well",
    )
    assert list_doubts(weights, usual, usual, {"explained_share": 0.95}) == ()


def _nothing(s: dict[str, np.ndarray]) -> np.ndarray:
    return 0.0 * s["radius"]


EXTINGUISHER = Template(
    kind="extinguisher",
    sizes=(
        Size("radius", 0.05, 0.1, 0.075, 0.012, "EN 3: 110 to 190 mm across"),
        Size("height", 0.25, 0.6, 0.45, 0.08, "EN 3: 300 to 620 mm high"),
    ),
    build=lambda s: (
        Part("body", Cylinder(columns(_nothing(s), 0.0, 0.0), columns(_nothing(s), 0.0, s["height"]), s["radius"])),
    ),
    hollows=lambda s: (),
    mount="support",
    looseness=Looseness(tilt=0.03, height=0.008),
    reach=0.1,
    extent="height",
    middle=lambda s: columns(_nothing(s), 0.0, 0.5 * s["height"]),
    model_sigma=0.003,
    starts=Starts(sizes=np.array([[0.075, 0.45]]), over=(0.03, 0.8), lifts=np.zeros(1), n_turns=1),
)


def test_a_kind_of_one_template_is_found_by_a_click() -> None:
    floor, body = box((-3.0, -3.0, -0.1), (3.0, 3.0, 0.0)), cylinder((1.0, 0.2, 0.0), (1.0, 0.2, 0.4), 0.065, 48)
    cloud = scan([floor, body], Pose((0.0, 0.0, 1.3), pitch=0.8), SCANNER, 0)
    around = Surroundings.of(cloud.points, cloud.origin, np.array([0.95, 0.25, 0.3]))
    fit = fit_at(EXTINGUISHER, around, sight_index(cloud))[0]
    assert fit.hypotheses.place[0, :2] == pytest.approx([1.0, 0.2], abs=0.01)
    assert fit.hypotheses.sizes[0] == pytest.approx([0.065, 0.4], abs=0.02)
