"""Bodies of doors agree with the simulator's meshes and with the geometry they are made from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from perception.detect.door.bodies import HANDLE_LINK, LEAF_LINK, door_bodies
from perception.detect.door.geometry import UP, DoorGeometry
from perception.simulate import Caster, Mesh, join_meshes
from perception.simulate.scenes.doors import Door, truth_geometry


def _sampled(mesh: Mesh, rng: np.random.Generator, n: int = 150) -> np.ndarray:
    """Random points on a mesh, more on larger triangles."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles], 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    chosen = rng.choice(len(area), n, p=area / area.sum())
    u, v = rng.uniform(size=(2, n, 1))
    u, v = np.where(u + v > 1.0, 1.0 - u, u), np.where(u + v > 1.0, 1.0 - v, v)
    return np.asarray(a[chosen] + u * (b - a)[chosen] + v * (c - a)[chosen])


def _beyond(points: np.ndarray, bodies: list[np.ndarray]) -> np.ndarray:
    """How far points lie outside of every body, at least the distance to its nearest face plane [m]."""
    depths = []
    for vertices in bodies:
        planes = ConvexHull(vertices).equations
        depths.append((points @ planes[:, :3].T + planes[:, 3]).max(axis=1))
    return np.asarray(np.min(depths, axis=0))


def _all_bodies(geometry: DoorGeometry) -> list[np.ndarray]:
    return [vertices for link in door_bodies(geometry).values() for vertices in link.values()]


doors = st.builds(
    Door,
    hinge=st.tuples(st.floats(0.5, 2.0), st.floats(-1.0, 1.0)),
    along=st.floats(-3.0, 3.0),
    hinge_on=st.sampled_from(["left", "right"]),
    side=st.sampled_from(["pull", "push"]),
    ajar=st.floats(0.0, 0.6),
    width=st.floats(0.7, 1.1),
    furniture=st.sampled_from(["lever", "knob", "bar", "pull", "plate", "none"]),
    lever_length=st.floats(0.1, 0.17),
    lever_turn=st.floats(0.0, 0.6),
    handle_radius=st.floats(0.007, 0.014),
    pull_length=st.floats(0.2, 0.6),
    standoff=st.one_of(st.none(), st.floats(0.045, 0.075)),
)


@settings(max_examples=30, deadline=None)
@given(doors)
def test_bodies_agree_with_the_simulated_meshes_within_3_mm(door: Door) -> None:
    if door.furniture == "knob":
        door = replace(door, standoff=None)
    rng = np.random.default_rng(0)
    bodies = _all_bodies(truth_geometry(door))
    meshes = door.shut_meshes()
    surface = np.concatenate([_sampled(mesh, rng) for mesh in meshes])
    beyond = _beyond(surface, bodies)
    assert beyond.max() < 0.003
    if door.furniture != "knob":  # The hull of a knob fills its neck.
        corners = np.concatenate(bodies)
        inside = _beyond(corners, [mesh.vertices for mesh in meshes]) < 0.0
        assert Caster(join_meshes(meshes)).distance(corners)[~inside].max() < 0.003


def test_the_bodies_of_each_kind_of_handle_are_on_their_link() -> None:
    expected = {
        "lever": ({"leaf", "rose"}, {"lever", "neck"}),
        "bar": ({"leaf", "housing 1", "housing 2"}, {"bar"}),
        "pull": ({"leaf", "bar", "post 1", "post 2"}, set()),
        "knob": ({"leaf", "knob", "rose"}, set()),
        "plate": ({"leaf"}, set()),
    }
    for furniture, (leaf, handle) in expected.items():
        bodies = door_bodies(truth_geometry(Door(furniture=furniture)))  # type: ignore[arg-type]
        assert set(bodies[LEAF_LINK]) == leaf
        assert set(bodies.get(HANDLE_LINK, {})) == handle
        assert (HANDLE_LINK in bodies) == bool(handle)
        assert all(4 <= len(vertices) <= 32 for link in bodies.values() for vertices in link.values())


@pytest.mark.parametrize(
    ("hinge_on", "side"), [("left", "pull"), ("right", "pull"), ("left", "push"), ("right", "push")]
)
def test_the_true_hinge_turns_the_shut_leaf_onto_the_open_one(hinge_on: str, side: str) -> None:
    door = Door(hinge_on=hinge_on, side=side, ajar=0.3, furniture="none")  # type: ignore[arg-type]
    geometry = truth_geometry(door)
    slab = door_bodies(geometry)[LEAF_LINK]["leaf"] - geometry.hinge
    axis, angle = geometry.hinge_axis, geometry.ajar
    turned = (
        slab * np.cos(angle)
        + np.cross(axis, slab) * np.sin(angle)
        + np.outer(slab @ axis, axis) * (1.0 - np.cos(angle))
        + geometry.hinge
    )
    surface = Caster(join_meshes(door.build().meshes))
    assert surface.distance(turned).max() < 1e-6
    assert geometry.normal @ UP == 0.0
