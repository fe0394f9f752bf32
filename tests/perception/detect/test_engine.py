"""The engine for templates: distances, derivatives, fits of pose and sizes, and confidences that last digits leave."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from perception import CONFIDENT, Cloud, detect, make_view
from perception.detect.engine.primitives import Box, Capsule, Cylinder, Torus, nearest_part
from perception.detect.engine.refine import Hypotheses, _jacobian, refine
from perception.detect.engine.region import Mounting, gather
from perception.detect.engine.rivals import lead_over_rivals
from perception.detect.engine.score import FEATURES, weigh
from perception.detect.engine.search import Site, search
from perception.detect.engine.template import Looseness, Part, Size, Template, columns
from perception.detect.engine.templates.drill import DRILL
from perception.detect.engine.templates.lever import LEVER
from perception.detect.engine.templates.wheel import WHEEL
from perception.detect.engine.verdict import confidence_of, rate
from perception.detect.shared.detection import Detection
from perception.sightlines import sight_index
from perception.simulate import Pose, Scanner, box, cylinder, scan, torus
from perception.simulate.scenes.loose import Drill
from perception.view import widen

TOP = 0.8
SENSOR = Pose((0.1, 0.0, 1.5), pitch=0.7)
SCANNER = Scanner(n_beams=541, fan_deg=160.0, n_lines=70)


def scan_of_drill() -> Cloud:
    drill = Drill((0.8, 0.1, TOP), np.radians(70.0)).build()
    room = [box((-5.0, -5.0, -0.1), (5.0, 5.0, 0.0)), box((0.5, -0.6, TOP - 0.03), (1.2, 0.6, TOP))]
    return scan([*room, *drill.meshes], SENSOR, SCANNER, 0)


def _nothing(s: dict[str, np.ndarray]) -> np.ndarray:
    return 0.0 * next(iter(s.values()))


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
)


def _rocker(s: dict[str, np.ndarray]) -> Box:
    return Box(columns(_nothing(s), 0.0, 0.012), columns(0.3 * s["width"], 0.3 * s["height"], 0.012))


SWITCH = Template(
    kind="light switch",
    sizes=(
        Size("width", 0.06, 0.16, 0.085, 0.02, "BS 4662 and DIN 49073 plates"),
        Size("height", 0.06, 0.16, 0.085, 0.02, "BS 4662 and DIN 49073 plates"),
    ),
    build=lambda s: (
        Part("plate", Box(columns(_nothing(s), 0.0, 0.006), columns(0.5 * s["width"], 0.5 * s["height"], 0.006))),
        Part(
            "rocker", Box(columns(_nothing(s), 0.0, 0.012), columns(0.3 * s["width"], 0.3 * s["height"], 0.012)), False
        ),
    ),
    hollows=lambda s: (),
    mount="face",
    looseness=Looseness(tilt=0.03, height=0.003),
    reach=0.12,
    middle=lambda s: columns(_nothing(s), 0.0, 0.0),
    model_sigma=0.002,
)


def rows(*values: float) -> np.ndarray:
    return np.array([values])


def test_distances_are_those_worked_out_by_hand() -> None:
    at = np.array([[[3.0, 0.0, 0.0], [0.0, 2.0, 0.0]]])
    one = np.array([0.5])
    assert Capsule(rows(-1.0, 0.0, 0.0), rows(1.0, 0.0, 0.0), one).distance(at) == pytest.approx(rows(1.5, 1.5))
    assert Cylinder(rows(-1.0, 0.0, 0.0), rows(1.0, 0.0, 0.0), one).distance(at) == pytest.approx(rows(2.0, 1.5))
    assert Box(rows(0.0, 0.0, 0.0), rows(1.0, 3.0, 1.0)).distance(at) == pytest.approx(rows(2.0, -1.0))
    assert Torus(np.zeros(1), np.array([2.0]), one).distance(at) == pytest.approx(rows(0.5, -0.5))


def test_derivatives_by_pose_and_sizes_agree_with_central_differences() -> None:
    rng = np.random.default_rng(0)
    rotation, place, sizes = (
        Rotation.from_rotvec([[0.2, -0.4, 0.3]]).as_matrix(),
        rows(0.1, 0.2, 0.3),
        DRILL.usual[None],
    )
    fits = Hypotheses.of(rotation, place, sizes, np.array([0.0, 0.0, 1.0]))
    world = place + rng.uniform(-0.15, 0.15, (40, 3))
    at = fits.local(world)
    solids = DRILL.solids(sizes)
    part = nearest_part(solids, at)[1]
    jacobian = _jacobian(DRILL, fits, solids, at, part, np.ones(part.shape, dtype=bool))[0]

    def distance(step: np.ndarray) -> np.ndarray:
        turned = Rotation.from_rotvec(step[None, :3]).as_matrix() @ rotation
        moved = replace(fits, rotation=turned, place=place + step[3:6], sizes=sizes + step[6:])
        return np.min([solid.distance(moved.local(world))[0] for solid in DRILL.solids(moved.sizes)], axis=0)

    for i, step in enumerate(1e-5 * np.eye(jacobian.shape[1])):
        central = (distance(step) - distance(-step)) / 2e-5
        # Where two parts are equally near, the derivative jumps.
        assert np.median(np.abs(jacobian[:, i] - central)) < 1e-3
        assert np.mean(np.abs(jacobian[:, i] - central) < 0.02) > 0.9


def test_a_rim_is_fitted_to_two_millimetres_from_two_centimetres_off() -> None:
    wheel = torus((0.9, 0.0, 1.1), (1.0, 0.0, 0.0), 0.15, 0.012, 96, 24)
    fine = replace(SCANNER, sigma=0.003)
    cloud = scan([wheel, box((1.5, -2.0, 0.0), (1.6, 2.0, 2.5))], Pose((0.0, 0.1, 1.4), pitch=0.2), fine, 0)
    facing = np.array([[[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]])
    begun = Hypotheses.of(facing, rows(0.89, 0.012, 1.085), rows(0.135, 0.015), np.array([0.0, 0.0, 1.0]))
    region = gather(sight_index(cloud), np.array([0.9, 0.0, 1.1]), 0.2, None, 1500)
    fitted = refine(WHEEL, begun, region, np.geomspace(0.02, 0.008, 14).tolist())
    sigma = np.sqrt(np.diag(np.linalg.inv(fitted.information[0] + 1e-6 * np.eye(8))))
    off = np.abs(fitted.hypotheses.place[0] - (0.9, 0.0, 1.1))
    assert (off < np.maximum(0.002, 3.0 * sigma[3:6])).all()
    assert np.linalg.norm(off) < 0.006
    assert fitted.hypotheses.sizes[0] == pytest.approx([0.15, 0.012], abs=0.002)


def rate_best(cloud: Cloud) -> Detection:
    """The best drill of a cloud, rated by the engine."""
    view = make_view(cloud)
    return rate(detect("drill", view)[0], sight_index(widen(view).cloud))


@cache
def rate_drill() -> Detection:
    """The drill of ``scan_of_drill``, rated by the engine."""
    return rate_best(scan_of_drill())


def test_last_digits_and_order_do_not_change_a_confidence() -> None:
    cloud = scan_of_drill()
    rng = np.random.default_rng(0)
    order = rng.permutation(len(cloud.points))
    points = (cloud.points + rng.normal(0.0, 1e-9, cloud.points.shape))[order]
    other = rate_best(Cloud(points, cloud.origin))
    assert other.confidence == pytest.approx(rate_drill().confidence, abs=0.02)


def test_rays_that_pass_an_object_lower_its_confidence() -> None:
    hit = rate_drill()
    features = np.array([hit.residuals[f"ray_{name}"] for name in FEATURES])
    passed = features.copy()
    passed[FEATURES.index("solid_share")] -= 0.5
    passed[FEATURES.index("past_share")] += 0.5
    # A ray that passes tells against the object and not against its rivals.
    for name in ("gain", "lead"):
        passed[FEATURES.index(name)] -= 2.0
    assert confidence_of("drill", passed, 0.5) < CONFIDENT < confidence_of("drill", features, 0.5)


def test_an_object_moved_aside_loses_its_evidence() -> None:
    cloud = scan_of_drill()
    truth = Drill((0.8, 0.1, TOP), np.radians(70.0)).build().truth[0]
    rotation = truth.pose_world_object[None, :3, :3]
    sizes = DRILL.usual[None].copy()
    foot = truth.pose_world_object[:3, 3] - 0.115 * truth.pose_world_object[:3, 2]
    region = gather(sight_index(cloud), truth.pose_world_object[:3, 3], 0.22, None, 600)
    gains = [
        float(
            weigh(DRILL, Hypotheses.of(rotation, rows(*(foot + np.array([0.0, y, 0.0]))), sizes, foot), region).gain[0]
        )
        for y in (0.0, 0.06)
    ]
    assert gains[0] > gains[1] + 20.0


def test_an_extinguisher_is_fitted_by_a_template_of_a_few_lines() -> None:
    floor, body = box((-3.0, -3.0, -0.1), (3.0, 3.0, 0.0)), cylinder((1.0, 0.2, 0.0), (1.0, 0.2, 0.4), 0.065, 48)
    fine = replace(SCANNER, sigma=0.003)
    index = sight_index(scan([floor, body], Pose((0.0, 0.0, 1.3), pitch=0.8), fine, 0))
    mounting = Mounting(np.eye(3), np.zeros(3), 0.004)
    begun = Hypotheses.of(np.eye(3)[None], rows(1.02, 0.18, 0.0), EXTINGUISHER.usual[None], np.array([0.0, 0.0, 1.0]))
    fit = search(EXTINGUISHER, [Site(np.array([1.0, 0.2, 0.2]), mounting, begun)], index)[0]
    assert fit.hypotheses.place[0, :2] == pytest.approx([1.0, 0.2], abs=0.005)
    assert fit.hypotheses.sizes[0] == pytest.approx([0.065, 0.4], abs=0.01)
    assert fit.features[FEATURES.index("solid_share")] > 0.95


def test_a_light_switch_is_fitted_by_a_template_of_a_few_lines() -> None:
    parts = [box((1.0, -2.0, 0.0), (1.1, 2.0, 2.5)), box((0.988, -0.05, 1.05), (1.0, 0.05, 1.15))]
    dense = Scanner(n_beams=1081, fan_deg=90.0, n_lines=200, sigma=0.002)
    rocker = box((0.976, -0.03, 1.07), (0.99, 0.03, 1.13))
    index = sight_index(scan([*parts, rocker], Pose((0.2, 0.1, 1.3), pitch=0.1), dense, 0))
    facing = np.stack([np.column_stack([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])])
    wall = Mounting(facing[0].T, np.array([1.0, 0.0, 1.1]), 0.002)
    begun = Hypotheses.of(facing, rows(1.0, 0.01, 1.095), SWITCH.usual[None], np.array([-1.0, 0.0, 0.0]))
    fit = search(SWITCH, [Site(np.array([1.0, 0.0, 1.1]), wall, begun)], index)[0]
    assert fit.hypotheses.place[0] == pytest.approx([1.0, 0.0, 1.1], abs=0.005)
    assert fit.hypotheses.sizes[0] == pytest.approx([0.1, 0.1], abs=0.01)


def test_a_box_is_explained_better_by_a_box_than_by_a_drill() -> None:
    room = [box((-5.0, -5.0, -0.1), (5.0, 5.0, 0.0)), box((0.5, -0.6, TOP - 0.03), (1.2, 0.6, TOP))]
    index = sight_index(scan([*room, box((0.72, 0.07, TOP), (0.9, 0.13, TOP + 0.22))], SENSOR, SCANNER, 0))
    drill_index = sight_index(scan_of_drill())
    leads = []
    for rays, yaw in ((index, 0.0), (drill_index, 70.0)):
        rotation = Rotation.from_rotvec([[0.0, 0.0, np.radians(yaw)]]).as_matrix()
        begun = Hypotheses.of(rotation, rows(0.8, 0.1, TOP), DRILL.usual[None], np.array([0.0, 0.0, 1.0]))
        region = gather(
            rays, np.array([0.8, 0.1, TOP + 0.1]), 0.22, Mounting(np.eye(3), rows(0.8, 0.1, TOP)[0], 0.004), 600
        )
        fit = refine(DRILL, begun, region, (0.02, 0.015, 0.01, 0.01)).hypotheses
        leads.append(lead_over_rivals(DRILL, fit, region))
    assert leads[0] < 0.0 < leads[1]


@pytest.mark.parametrize(("begun_deg", "least", "most"), [(8.0, 0.0, 3.0), (60.0, 55.0, 60.5)])
def test_a_lever_that_rays_leave_open_is_level_unless_it_is_clearly_turned(
    begun_deg: float, least: float, most: float
) -> None:
    cloud = scan([box((1.0, -1.0, 0.0), (1.1, 1.0, 2.0))], Pose((0.0, 0.0, 1.2)), SCANNER, 0)
    out = np.array([-1.0, 0.0, 0.0])
    mounting = Mounting(np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], out]), np.array([1.0, 0.0, 1.0]), 0.002)
    place = np.array([0.9, 0.0, 1.0])
    region = gather(sight_index(cloud), place, 0.3, mounting, 400)
    turned = Rotation.from_rotvec(np.radians(begun_deg) * out).as_matrix() @ mounting.frame.T
    # All rays that end beyond it pass beside it: none says how it is turned.
    few = region.select(np.flatnonzero(np.abs(region.ends[:, 1]) > 0.25))
    fit = refine(LEVER, Hypotheses.of(turned[None], place[None], LEVER.usual[None], out), few, (0.01,) * 8)
    slope = np.degrees(np.arcsin(abs(fit.hypotheses.rotation[0, 2, 0])))
    assert least <= slope <= most
