"""Contacts: placing, joining, pyramids, tilt, and refusals."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from costs.contact import N_PYRAMID_EDGES, Contact, WorldContacts

UP = np.array([[0.0, 0.0, 1.0]])


def a_contact(**changes):
    fields = {"link": "l_foot", "points": np.zeros((1, 3)), "normals": UP, "friction": 0.6, "force_cap_n": 500.0}
    return Contact(**(fields | changes))


def random_directions(rng, count):
    directions = rng.normal(size=(count, 3))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def random_contacts(rng, count=6):
    points, normals = rng.normal(size=(count, 3)), random_directions(rng, count)
    return WorldContacts(points, normals, rng.uniform(0.2, 1.5, count), rng.uniform(1.0, 900.0, count))


def test_a_link_turned_by_90_degrees_about_x_presses_against_a_wall():
    contact = a_contact(points=np.array([[0.1, 0.2, 0.0]]))
    pose = np.array([[1.0, 0.0, 0.0, 5.0], [0.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, 1.0], [0.0, 0.0, 0.0, 1.0]])
    placed = contact.place(pose)
    np.testing.assert_allclose(placed.points, [[5.1, 0.0, 1.2]])
    np.testing.assert_allclose(placed.normals, [[0.0, -1.0, 0.0]])
    assert placed.friction.tolist() == [0.6]
    assert placed.caps.tolist() == [500.0]


def test_joined_contacts_keep_their_sequence():
    first, second = a_contact().place(np.eye(4)), a_contact(friction=0.3, force_cap_n=7.0).place(np.eye(4))
    joined = WorldContacts.join([first, second])
    assert joined.friction.tolist() == [0.6, 0.3]
    assert joined.caps.tolist() == [500.0, 7.0]
    with pytest.raises(ValueError, match="at least one contact, got none"):
        WorldContacts.join([])


@given(seed=st.integers(0, 10_000))
def test_pyramid_edges_have_unit_normal_force_and_lie_on_the_cone(seed):
    contacts = random_contacts(np.random.default_rng(seed))
    edges = contacts.list_pyramid_edges()
    assert edges.shape == (6, N_PYRAMID_EDGES, 3)
    along = np.einsum("cki,ci->ck", edges, contacts.normals)
    np.testing.assert_allclose(along, 1.0, atol=1e-9)
    sideways = np.linalg.norm(edges - along[..., None] * contacts.normals[:, None], axis=2)
    np.testing.assert_allclose(sideways, np.repeat(contacts.friction[:, None], N_PYRAMID_EDGES, axis=1), atol=1e-9)
    np.testing.assert_allclose(edges.mean(axis=1), contacts.normals, atol=1e-9)


def test_a_wall_holds_its_full_friction_upwards():
    wall = WorldContacts(np.zeros((1, 3)), np.array([[-0.6, 0.8, 0.0]]), np.array([0.5]), np.array([100.0]))
    assert wall.list_pyramid_edges()[0, :, 2].max() == pytest.approx(0.5)


@given(seed=st.integers(0, 10_000), tilt=st.floats(0.0, 0.15))
def test_forces_within_the_tilted_cones_suit_every_normal_that_is_off_by_the_tilt(seed, tilt):
    rng = np.random.default_rng(seed)
    contacts = random_contacts(rng)
    shrunk = contacts.tilt_normals(tilt)
    edges = shrunk.list_pyramid_edges()
    forces = shrunk.caps[:, None] * edges[:, 0]
    aside = np.cross(contacts.normals, random_directions(rng, 6))
    # the worst normals lean away from the force, and towards it
    aside[:3] = (edges[:, 0] - contacts.normals)[:3]
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    for angle in tilt * np.linspace(-1.0, 1.0, 21):
        normals = np.cos(angle) * contacts.normals + np.sin(angle) * aside
        pressing = np.einsum("ci,ci->c", forces, normals)
        sideways = np.linalg.norm(forces - pressing[:, None] * normals, axis=1)
        assert (sideways <= contacts.friction * pressing * (1.0 + 1e-9)).all()
        assert (pressing <= contacts.caps * (1.0 + 1e-9)).all()


def test_a_tilt_that_leaves_no_friction_is_refused():
    contacts = a_contact(friction=0.1).place(np.eye(4))
    with pytest.raises(ValueError, match=r"leaves no friction at contact point 0.*0\.0997 rad"):
        contacts.tilt_normals(0.1)
    with pytest.raises(ValueError, match="tilt_rad must be finite and not negative"):
        contacts.tilt_normals(np.nan)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"points": np.zeros((0, 3)), "normals": np.zeros((0, 3))},
            r"contact of l_foot: points must have shape \(C, 3\)",
        ),
        ({"points": np.zeros(3)}, r"points must have shape \(C, 3\) with C at least 1, got \(3,\)"),
        ({"normals": np.zeros((2, 3))}, r"normals must have the shape of points, \(1, 3\), got \(2, 3\)"),
        ({"points": np.array([[0.0, np.nan, 0.0]])}, r"points\[0\] must be finite"),
        ({"normals": np.array([[0.0, 0.0, np.inf]])}, r"normals\[0\] must be finite"),
        ({"normals": 2.0 * UP}, r"normals\[0\] must be a unit vector, its length is 2"),
        ({"friction": -0.1}, "friction must be finite and not negative, got -0.1"),
        ({"friction": np.nan}, "friction must be finite and not negative, got nan"),
        ({"force_cap_n": 0.0}, "force_cap_n must be positive and finite, got 0"),
        ({"force_cap_n": np.inf}, "force_cap_n must be positive and finite, got inf"),
        ({"force_cap_n": np.nan}, "force_cap_n must be positive and finite, got nan"),
    ],
)
def test_contacts_that_make_no_sense_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        a_contact(**changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"friction": np.array([0.5, 0.5])}, r"friction must have shape \(1,\), got \(2,\)"),
        ({"caps": np.array([np.inf])}, r"caps\[0\] must be positive and finite, got inf"),
        ({"friction": np.array([-1.0])}, "friction must be finite and not negative, got -1"),
    ],
)
def test_world_contacts_that_make_no_sense_are_refused(changes, message):
    fields = {"points": np.zeros((1, 3)), "normals": UP, "friction": np.array([0.5]), "caps": np.array([9.0])}
    with pytest.raises(ValueError, match=message):
        WorldContacts(**(fields | changes))
