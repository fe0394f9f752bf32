"""Scenes with several given objects each, hung and lying, of which some are mirrored or alike.

Objects with the suffix ``mesh`` are searched for by a mesh whose vertices are 1.5 mm off.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from perception.simulate.scenes import SimulatedScene
from perception.simulate.scenes.loose import Drill, shelf, table
from perception.simulate.scenes.scene import (
    PlacedObjects,
    assemble,
    cartons,
    floor,
    frame,
    generator,
    make_room,
    pose_of,
    things,
    upright_pipe,
)
from perception.simulate.scenes.valves import tilt_axis
from perception.solids.mesh import Mesh, Solid, make_solid
from perception.solids.places import spread_samples
from perception.solids.primitives import bent_bar, box, cylinder, join_meshes, lathe
from perception.solids.rating import measure_solid
from perception.solids.shapes import make_box, make_cylinder, make_lever, make_wheel, unite_meshes

_MESH_ERROR = 0.0015  # standard deviation of a vertex [m]
_SAMPLES, _MOST_OFF = 400, 0.95
_ABSENT = 4

_BRACKET = (
    box((-0.15, -0.1, 0.0), (0.15, 0.1, 0.02)),
    box((-0.15, -0.1, 0.0), (-0.13, 0.1, 0.22)),
    cylinder((0.08, 0.04, 0.0), (0.08, 0.04, 0.12), 0.03),
)
_MIRRORED = tuple(Mesh(part.vertices * (1.0, -1.0, 1.0), part.triangles[:, ::-1]) for part in _BRACKET)
_MUG = (
    lathe([(0.0, 0.0), (0.08, 0.0), (0.08, 0.18), (0.075, 0.18), (0.075, 0.005), (0.0, 0.005)]),
    bent_bar([(0.075, 0.0, 0.04), (0.13, 0.0, 0.05), (0.13, 0.0, 0.13), (0.075, 0.0, 0.14)], 0.012),
)
_TEE = (cylinder((0.0, -0.18, 0.0), (0.0, 0.18, 0.0), 0.04), cylinder((0.0, 0.0, 0.0), (0.0, 0.0, 0.2), 0.04))
_ELBOW = (
    cylinder((0.0, 0.0, 0.0), (0.25, 0.0, 0.0), 0.035),
    cylinder((0.0, 0.0, 0.0), (0.0, 0.0, 0.18), 0.035),
    cylinder((0.24, 0.0, 0.0), (0.26, 0.0, 0.0), 0.07),
)
_HAMMER = (cylinder((0.0, 0.0, 0.0), (0.35, 0.0, 0.0), 0.018), box((0.33, -0.07, -0.025), (0.38, 0.07, 0.025)))
_STEP = (box((0.0, 0.0, 0.0), (0.3, 0.2, 0.1)), box((0.0, 0.0, 0.1), (0.15, 0.2, 0.2)))
_FLANGE = (cylinder((0.0, 0.0, 0.0), (0.0, 0.0, 0.02), 0.12), cylinder((0.0, 0.0, 0.0), (0.0, 0.0, 0.2), 0.06))
HUNG: Mapping[str, Sequence[Mesh]] = {
    "wheel_15": make_wheel(0.15, 0.012, 5),
    "wheel_22": make_wheel(0.22, 0.014, 3),
    "wheel_32": make_wheel(0.32, 0.016, 6),
    "ring_20": make_wheel(0.2, 0.02, 0),
    "crank_22": make_lever(0.22, 0.012, 0.1),
    "crank_30": make_lever(0.3, 0.015, 0.12),
    "lever_28": make_lever(0.28, 0.015),
}
LYING: Mapping[str, Sequence[Mesh]] = {
    "bracket": _BRACKET,
    "bracket_mirrored": _MIRRORED,
    "tank": make_cylinder(0.12, 0.4),
    "case": make_box((0.4, 0.24, 0.14)),
    "brick": make_box((0.3, 0.2, 0.2)),
    "elbow": _ELBOW,
    "mug": _MUG,
    "tee_mesh": _TEE,
    "hammer_mesh": _HAMMER,
    "step_mesh": _STEP,
    "flange_mesh": _FLANGE,
    "drill_mesh": Drill((0.0, 0.0, 0.0)).build().meshes,
}
# Searched for where only the other is.
_ALIKE: Mapping[str, str] = {
    "bracket": "bracket_mirrored",
    "bracket_mirrored": "bracket",
    "crank_22": "lever_28",
    "lever_28": "crank_30",
    "crank_30": "lever_28",
    "ring_20": "wheel_22",
    "wheel_22": "ring_20",
    "wheel_15": "ring_20",
    "tank": "flange_mesh",
    "brick": "case",
    "case": "brick",
    "tee_mesh": "elbow",
    "elbow": "tee_mesh",
    "hammer_mesh": "tee_mesh",
    "step_mesh": "brick",
    "flange_mesh": "tank",
}


@dataclass(frozen=True)
class Mixed:
    """A scene with the poses of its objects (4, 4) by name, and the names of others to search for in it."""

    scene: SimulatedScene
    poses: Mapping[str, Float[np.ndarray, "4 4"]]
    absent: tuple[str, ...]


def make_mixed(seed: int) -> Mixed:
    """Return a room with two objects on posts and two on a table, a pipe, cartons and a shelf."""
    rng = generator("given_mixed", seed)
    hung, lying = (rng.choice(list(names), 2, replace=False).tolist() for names in (HUNG, LYING))
    front = rng.uniform(1.5, 2.0)
    parts: list[PlacedObjects] = [floor(), make_room(front, -2.2, 2.2), table((0.7, -1.1, 0.0), 1.3, 0.7, 0.8)]
    parts.append(upright_pipe(front - 0.3, rng.uniform(-1.8, 1.8), rng.uniform(0.02, 0.08)))
    parts += cartons(rng, 3, (1.1, -1.5), 0.35)
    parts.append(shelf((front - 0.35, -1.9, 0.0), 0.6, 0.3, (0.4, 0.9, 1.4), 1.8))
    poses = {}
    for name, y in zip(hung, (0.55, 1.25), strict=True):
        poses[name] = _hang(rng, y, parts)
    for name, y in zip(lying, (-0.15, -0.75), strict=True):
        poses[name] = _lay(rng, name, y)
    parts += [things(*(part.place(pose) for part in (HUNG | LYING)[name])) for name, pose in poses.items()]
    others = [name for name in (*HUNG, *LYING) if name not in poses]
    absent = rng.choice(others, _ABSENT, replace=False).tolist()
    absent += [_ALIKE[name] for name in poses if name in _ALIKE and _ALIKE[name] not in (*poses, *absent)]
    scene = assemble("given_mixed", seed, parts, np.array([0.9, 0.2, 1.0]))
    return Mixed(scene, poses, tuple(dict.fromkeys(absent)))


def make_searched(name: str) -> Solid:
    """Return the solid that is searched for; meshes are not exact."""
    parts = (HUNG | LYING)[name]
    if name == "mug":
        return make_solid(join_meshes(parts), name)
    if name.endswith("_mesh"):
        rng = np.random.default_rng(1)
        parts = [
            Mesh(part.vertices + rng.normal(0.0, _MESH_ERROR, part.vertices.shape), part.triangles) for part in parts
        ]
    return unite_meshes(parts, name)


def compare_surfaces(solid: Solid, found: Float[np.ndarray, "4 4"], truth: Float[np.ndarray, "4 4"]) -> float:
    """Return how far 95 % of the surface at one pose are from that at the other, both ways [m].

    Symmetric objects thus have no errors about their axes.
    """
    surface, _, _ = measure_solid(solid)
    samples, _ = spread_samples(join_meshes([*solid.closed, *solid.open]), _SAMPLES)
    errors = []
    for one, other in ((found, truth), (truth, found)):
        places = (samples @ one[:3, :3].T + one[:3, 3] - other[:3, 3]) @ other[:3, :3]
        off = np.linalg.norm(places - surface.nearest(places)[0], axis=1)
        errors.append(float(np.quantile(off, _MOST_OFF)))
    return max(errors)


def _hang(rng: np.random.Generator, y: float, parts: list[PlacedObjects]) -> Float[np.ndarray, "4 4"]:
    """Return a pose about a place, and add the post that carries the object there."""
    axis = np.array(tilt_axis(rng.uniform(-45.0, 45.0), rng.uniform(-10.0, 60.0)))
    place = (rng.uniform(0.75, 1.05), y + rng.uniform(-0.1, 0.1), rng.uniform(0.8, 1.4))
    pose = frame(place, rng.normal(size=3).tolist(), axis.tolist())
    back = pose[:3, 3] - 0.25 * axis
    stem = cylinder((pose[:3, 3] - 0.02 * axis).tolist(), back.tolist(), rng.uniform(0.014, 0.025))
    parts.append(things(stem, cylinder((back[0], back[1], 0.0), (back[0], back[1], 2.0), rng.uniform(0.025, 0.045))))
    return pose


def _lay(rng: np.random.Generator, name: str, y: float) -> Float[np.ndarray, "4 4"]:
    """Return a pose on the table."""
    roll = 0.0 if name in ("bracket", "bracket_mirrored", "mug", "drill_mesh") else rng.choice([0.0, 0.5, 1.0]) * np.pi
    place = (rng.uniform(0.9, 1.15), y + rng.uniform(-0.1, 0.1), 0.0)
    pose = pose_of(place, yaw=rng.uniform(-np.pi, np.pi), roll=roll)
    pose[2, 3] = 0.8 - min(float((part.vertices @ pose[2, :3]).min()) for part in LYING[name])
    return pose
