"""Scans for measuring perception, recorded and simulated, with the ground truth of each."""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float

from benchmarks.clouds.truth import truth_of
from perception import KINDS, Cloud, Reach, read_cloud
from perception.simulate import Caster, Mesh, join_meshes
from perception.simulate.scenes import SCENES, VARIANTS, SimulatedScene, Truth, make_scene

# Axes of a camera (z forward, y down) in the robot's (x forward, z up), and axes that are those already.
_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
_LEVEL = np.eye(3)


@dataclass(frozen=True)
class Case:
    """A scan with its ground truth.

    Attributes:
        name: unique.
        density: "dense" or "sparse": which targets hold.
        load: returns the scan.
        truth: objects in it.
        lookalikes: (kind, places (K, 3)) of objects that count neither as hits nor as errors of that kind.
        unknown: kinds that the truth does not cover.
        surface: returns the true surfaces; None if unknown.
        judge: returns another scan of the same scene; None if there is none.
        reach: where it is looked at.
        is_heap: whether twice as many pieces are due.
        is_room: whether it is a whole room, with targets of its own.
        has_rays: whether where its rays started is known.
    """

    name: str
    density: str
    load: Callable[[], Cloud]
    truth: tuple[Truth, ...] = ()
    lookalikes: tuple[tuple[str, Float[np.ndarray, "K 3"]], ...] = ()
    unknown: frozenset[str] = frozenset()
    surface: Callable[[], Caster] | None = None
    judge: Callable[[], Cloud] | None = None
    reach: Reach = field(default_factory=Reach)
    is_heap: bool = False
    is_room: bool = False
    has_rays: bool = True


def data_folder() -> Path:
    """Return the folder of recorded scans: ``SCOPT_DATA``, or ``../shared/data`` beside the checkout."""
    return Path(os.environ.get("SCOPT_DATA", Path(__file__).parents[3] / "shared" / "data"))


def scene_cases(folder: Path) -> Iterator[Case]:
    """Yield scans of known scenes: ``scenes/<name>/scan*.pcd`` with ``gt.ply`` and ``gt.json``."""
    for path in sorted((folder / "scenes").glob("*/scan*.pcd")):
        document = json.loads((path.parent / "gt.json").read_text())
        spin = next(one["spin_rev_s"] for one in document["scans"] if one["file"] == path.name)
        mesh = _mesh(path.parent / "gt.ply")
        truth, lookalikes, unknown = truth_of(document, mesh)
        others = [other for other in sorted(path.parent.glob("scan*.pcd")) if other != path]
        yield Case(
            f"{path.parent.name}/{path.stem}",
            "dense" if spin < 0.5 else "sparse",
            partial(read_cloud, path),
            truth,
            lookalikes,
            unknown,
            partial(Caster, mesh),
            partial(read_cloud, others[0]) if others else None,
            is_heap=len(document.get("beams", ())) > 3,
        )


def recorded_cases(folder: Path) -> Iterator[Case]:
    """Yield third-party clouds (``clouds/*``); it is only known that some kinds of objects are absent."""
    frames: Mapping[str, tuple[np.ndarray, float, bool, bool]] = {
        # axes, radius of the reach [m], whether it is a whole room, whether rays start at the file's zero
        "room_scan1": (_LEVEL, 16.0, True, True),
        "kinect_office_capture0001": (_OPTICAL, 4.0, False, True),
        "eth_car_cloud400": (_LEVEL, 10.0, True, False),
        "mit_octomap_scene1": (_LEVEL, 3.0, False, False),
    }
    for path in sorted((folder / "clouds").glob("*")):
        axes, radius, is_room, has_rays = frames.get(path.stem, (_LEVEL, 3.0, False, False))
        yield Case(
            path.stem,
            "dense",
            partial(_stood, path, axes, radius),
            unknown=frozenset(KINDS) - {"drill", "hose", "valve"},
            reach=Reach(radius=radius, top=4.0),
            is_room=is_room,
            has_rays=has_rays,
        )


def simulated_cases(variants: Sequence[str], seed: int = 0, *, misses: bool = False) -> Iterator[Case]:
    """Yield simulated scenes.

    Args:
        variants: sensors; those joined by a slash, as in ``solid/camera``, take turns.
        seed: of their details.
        misses: whether rays that hit nothing are included.
    """
    for i, name in enumerate(SCENES):
        for turns in variants:
            variant = turns.split("/")[i % len(turns.split("/"))]
            scene = make_scene(name, seed)
            yield Case(
                f"{name}:{variant}",
                "sparse" if "sparse" in variant else "dense",
                partial(scene.scan, variant, misses=misses),
                scene.truth,
                tuple((kind, place[None, :]) for kind, place in scene.lookalikes),
                frozenset(),
                partial(_caster, scene),
                partial(scene.scan, variant, 1),
                is_heap=name.startswith("debris"),
            )


def variant_turns(text: str) -> str:
    """An argument for :func:`simulated_cases`: a sensor, or several that take turns, joined by slashes."""
    unknown = [name for name in text.split("/") if name not in VARIANTS]
    if unknown:
        raise argparse.ArgumentTypeError(f"unknown sensor '{unknown[0]}'; {', '.join(VARIANTS)} are there")
    return text


def _mesh(path: Path) -> Mesh:
    import open3d as o3d

    read = o3d.io.read_triangle_mesh(path)
    return Mesh(np.asarray(read.vertices), np.asarray(read.triangles).astype(np.int64))


def _caster(scene: SimulatedScene) -> Caster:
    return Caster(join_meshes(scene.meshes))


def _stood(path: Path, axes: Float[np.ndarray, "3 3"], radius: float) -> Cloud:
    """Return a recorded cloud turned upright, its lowest layer within reach at zero, without echoes of the sensor."""
    cloud = read_cloud(path)
    points = cloud.points[np.linalg.norm(cloud.points - cloud.starts, axis=1) > 0.1] @ axes.T
    near = points[np.linalg.norm(points[:, :2], axis=1) <= radius]
    lift = np.array([0.0, 0.0, -np.percentile(near[:, 2], 1.0)])
    return Cloud(points + lift, cloud.origin @ axes.T + lift, cloud.notes)
