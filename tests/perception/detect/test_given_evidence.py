"""Evidence for a given object: what another shape, a block of its outline or a cut view shows is not believed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from perception import View, make_view
from perception.sightlines import Sightlines, sight_index
from perception.simulate import Pose, Scanner, SolidState, box, cylinder, scan
from perception.simulate.sensor import Sensor
from perception.solids.evidence import FieldOfView, Shape, find_noise, weigh_pose
from perception.solids.fit import MeshPose, find_wide_planes, make_pose_judge
from perception.solids.match import find_matches
from perception.solids.mesh import Mesh, Solid
from perception.solids.rating import MeshMatch, join_meshes, measure_solid
from perception.solids.settle import Place
from perception.solids.shapes import make_box, make_cylinder, make_lever, make_wheel, unite_meshes

ROOM = (box((-4.0, -4.0, -0.1), (4.0, 4.0, 0.0)), box((1.7, -2.5, 0.0), (1.8, 2.5, 2.4)))
TABLE = box((0.5, -0.8, 0.77), (1.3, 0.8, 0.8))
# Two plates of 30 cm x 20 cm and 20 cm x 20 cm that meet at an edge.
ANGLE = (box((-0.15, -0.1, 0.18), (0.15, 0.1, 0.2)), box((-0.15, -0.1, 0.0), (-0.13, 0.1, 0.2)))


def see(meshes: Sequence[Mesh], towards: Sequence[float] = (0.9, 0.0, 1.0), sensor: Sensor | None = None) -> View:
    """Return the view of meshes in a room."""
    start = Pose.looking((0.1, 0.0, 1.5), list(towards), 0.0)
    return make_view(scan([*meshes, *ROOM], start, sensor or Scanner(n_lines=120), 0))


def find(solid: Solid, view: View, near: Sequence[float]) -> MeshMatch:
    """Return the surest match."""
    return max(find_matches(solid, view, np.array(near)), key=lambda match: match.confidence)


def test_an_angle_is_not_believed_on_a_block_of_its_outline() -> None:
    block = box((0.75, -0.1, 0.8), (1.05, 0.1, 1.0))
    match = find(unite_meshes(ANGLE), see([TABLE, block]), (0.9, 0.0, 0.9))
    assert match.residuals["telling"] < 0.04
    assert match.confidence < 0.5


def test_tubes_that_branch_are_told_from_a_block() -> None:
    tubes = (cylinder((0.0, -0.2, 0.0), (0.0, 0.2, 0.0), 0.04), cylinder((0.0, 0.0, 0.0), (0.0, 0.0, 0.25), 0.04))
    pose = np.eye(4)
    pose[:3, 3] = (0.9, 0.0, 0.84)
    match = find(unite_meshes(tubes), see([TABLE, *(part.place(pose) for part in tubes)]), (0.9, 0.0, 0.9))
    assert match.residuals["telling"] > 0.2
    assert match.confidence >= 0.5


def test_a_lever_is_not_believed_on_a_post_that_leaves_the_field_of_view() -> None:
    # The arm that carries the sign touches the post 28 cm below the edge of the field of view.
    post = cylinder((0.9, 0.0, 0.0), (0.9, 0.0, 2.3), 0.015)
    sensor = SolidState(n_points=60_000, field_deg=30.0)
    lowest = 1.5 - 0.8 * np.tan(np.radians(15.0))
    sign = box((0.85, -0.4, lowest + 0.28), (0.95, 0.4, 2.3))
    view = see([post, sign], (0.9, 0.0, 1.5), sensor)
    match = find(unite_meshes(make_lever(0.25, 0.015)), view, (0.9, 0.0, lowest + 0.14))
    assert match.residuals["cut"] > 0.35
    assert match.confidence < 0.5


def weigh(solid: Solid, pose: MeshPose, view: View) -> dict[str, float]:
    """Return the evidence for a pose by name."""
    whole = join_meshes([*solid.closed, *solid.open])
    surface, centre, radius = measure_solid(solid)
    wide = find_wide_planes(view.obstacles, view.starts, radius, 0)
    index = sight_index(view.cloud)
    judge = make_pose_judge(surface, index, view, pose.to_world(centre), radius, wide)
    noise = find_noise(view, wide, pose.to_world(centre))
    return vars(weigh_pose(pose, Shape.of(whole, surface, centre, radius), judge, noise, FieldOfView.of(index.rays)))


def test_points_beside_a_cylinder_show_that_a_box_stands_there() -> None:
    view = see([TABLE, box((0.8, -0.1, 0.8), (1.0, 0.1, 1.2))])
    pose = MeshPose(np.eye(3), np.array([0.9, 0.0, 1.0]))
    other, own = (
        weigh(unite_meshes(make_cylinder(0.1, 0.4)), pose, view),
        weigh(unite_meshes(make_box((0.2, 0.2, 0.4))), pose, view),
    )
    assert other["beside"] > 0.1
    assert own["beside"] < 0.02
    assert own["confirmed"] > 0.95
    assert own["telling"] == np.inf


def test_a_surface_out_of_view_is_not_seen() -> None:
    wheel = make_wheel(0.3, 0.02, 4)
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    pose[:3, 3] = (1.0, 0.0, 1.2)
    meshes = [part.place(pose) for part in wheel]
    narrow = SolidState(n_points=60_000, field_deg=30.0)
    own = MeshPose(pose[:3, :3], pose[:3, 3])
    whole = weigh(unite_meshes(wheel), own, see(meshes, (1.0, 0.0, 1.2)))
    part = weigh(unite_meshes(wheel), own, see(meshes, (1.0, 0.35, 1.2), narrow))
    assert whole["seen"] > 0.95
    assert whole["cut"] == 0.0
    assert part["seen"] < 0.7
    assert part["cut"] > 0.3


def test_a_field_of_view_holds_what_its_rays_surround() -> None:
    y, z = np.meshgrid(np.linspace(-0.5, 0.5, 11), np.linspace(-0.3, 0.3, 7))
    ways = np.column_stack([np.ones(77), y.ravel(), z.ravel()])
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    start = np.array([1.0, 2.0, 3.0])
    field = FieldOfView.of(Sightlines(np.tile(start, (77, 1)), ways, np.ones(77)))
    assert field is not None
    places = start + np.array([[2.0, 0.9, 0.5], [2.0, 1.1, 0.0], [2.0, 0.0, -0.7], [-2.0, 0.0, 0.0]])
    assert field.holds(places).tolist() == [True, False, False, False]


@pytest.mark.parametrize("ways", [np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])])
def test_a_sensor_that_looks_all_round_has_no_field_of_view(ways: np.ndarray) -> None:
    assert FieldOfView.of(Sightlines(np.zeros((3, 3)), ways, np.ones(3))) is None


def test_noise_is_that_of_planes_at_the_same_range() -> None:
    view = see([TABLE], sensor=Scanner(n_lines=120, sigma=0.004))
    wide = find_wide_planes(view.obstacles, view.starts, 0.2, 0)
    assert find_noise(view, wide, np.array([0.9, 0.0, 1.0])) == pytest.approx(0.004, rel=0.4)


def test_poses_at_one_place_share_their_confidence() -> None:
    match = MeshMatch(np.eye(4), 0.6, {}, unite_meshes(ANGLE), 0.01)
    pose = MeshPose(np.eye(3), np.zeros(3))
    place = Place(np.zeros(3), 10.0, pose, match, 10.0, 1)
    assert place.shared.confidence == pytest.approx(0.6)
    place.enter(pose, replace(match, confidence=0.2), 10.0)
    assert place.shared.confidence == pytest.approx(0.6 * 0.6 / 0.8)
    place.enter(pose, replace(match, confidence=0.9), 10.0)
    assert place.shared.confidence == pytest.approx(0.9 * 0.9 / 1.5)
