"""Support polygons: hull, margins and refusals."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from costs.support import SupportPolygon

SQUARE = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0], [1.0, 1.0], [1.0, 0.0]])


def sole(x, y, yaw):
    """A foot 0.2 m long and 0.1 m wide about (x, y), turned by yaw."""
    corners = np.array([[a, b, 0.0] for a in (-0.1, 0.1) for b in (-0.05, 0.05)])
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    return corners @ turn.T + [x, y, 0.0]


def test_margins_of_a_square_by_hand():
    polygon = SupportPolygon.of_points(SQUARE)
    assert len(polygon.vertices) == 4
    points = np.array([[1.0, 1.0], [0.25, 1.0], [2.0, 0.5], [2.5, 1.0], [1.0, -3.0]])
    np.testing.assert_allclose(polygon.margin(points), [1.0, 0.25, 0.0, -0.5, -3.0], atol=1e-12)
    np.testing.assert_allclose(polygon.margin(np.array([1.0, 1.0])), [1.0])


def test_a_foot_turned_by_90_degrees_supports_along_its_new_length():
    straight = SupportPolygon.of_soles([sole(0.0, 0.0, 0.0)])
    turned = SupportPolygon.of_soles([sole(0.0, 0.0, 0.5 * np.pi)])
    aside = np.array([[0.0, 0.08]])
    np.testing.assert_allclose(straight.margin(aside), [-0.03], atol=1e-12)
    np.testing.assert_allclose(turned.margin(aside), [0.02], atol=1e-12)


def test_two_feet_with_yaw_span_the_hull_of_all_their_corners():
    # toes out by 45 degrees: the outermost corner of each foot is 0.15 / sqrt(2) beside its middle
    polygon = SupportPolygon.of_soles([sole(0.0, 0.1, 0.25 * np.pi), sole(0.0, -0.1, -0.25 * np.pi)])
    reach = 0.15 / np.sqrt(2.0)
    np.testing.assert_allclose(
        [polygon.vertices[:, 1].min(), polygon.vertices[:, 1].max()], [-0.1 - reach, 0.1 + reach]
    )
    np.testing.assert_allclose([polygon.vertices[:, 0].min(), polygon.vertices[:, 0].max()], [-reach, reach])
    assert polygon.margin(np.array([[0.0, 0.0]]))[0] > 0.0


@given(seed=st.integers(0, 10_000))
def test_normals_point_outwards_and_margins_agree_with_membership(seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(8, 2))
    polygon = SupportPolygon.of_points(points)
    np.testing.assert_allclose(np.linalg.norm(polygon.normals, axis=1), 1.0)
    assert polygon.margin(points).min() > -1e-12
    assert polygon.margin(rng.dirichlet(np.ones(8), 20) @ points).min() > -1e-12
    edges = np.roll(polygon.vertices, -1, axis=0) - polygon.vertices
    outside = polygon.vertices + 0.5 * edges + 0.3 * polygon.normals
    np.testing.assert_allclose(polygon.margin(outside), -0.3, atol=1e-9)
    turns = edges[:, 0] * np.roll(edges[:, 1], -1) - edges[:, 1] * np.roll(edges[:, 0], -1)
    assert (turns > 0.0).all()  # counter-clockwise


@pytest.mark.parametrize(
    "points",
    [np.zeros((0, 2)), np.array([[0.0, 0.0], [1.0, 0.0]]), np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]])],
    ids=["none", "two", "on a line"],
)
def test_degenerate_contacts_are_refused(points):
    with pytest.raises(ValueError, match="three contact points that are not on a line"):
        SupportPolygon.of_points(points)
