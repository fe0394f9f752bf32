"""Coverage, false obstacles, pieces, time and detection errors of perception, printed as a table.

Coverage: share of true surface points (3 cm above the floor, within 3 m) within 1 cm of the pieces.
False obstacle: share of samples along rays of another scan (or of a fifth of the rays, withheld) that lie inside a
piece and more than 2 cm from any true surface.  True points: the ground-truth mesh hit by each measured ray.

From the checkout's root: ``python -m benchmarks.clouds``.  Real scenes come from the folder ``SCOPT_DATA`` (default:
``../shared/data``); without it only simulated scans are measured.
"""

from __future__ import annotations

import json
import os
import resource
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike

from costs.scene import ConvexPiece
from perception import CONFIDENT, ValveDetection, detect_valves
from perception.clean import half_spaces
from perception.cloud import Cloud
from perception.files.read import read_cloud
from perception.perceive import Perceived, perceive
from perception.simulate import Pose, Room, Valve, scan

REACH = 3.0  # [m]
TARGET_CPU_S = 2.0  # of one scan, cloud to pieces


def inside_pieces(
    points: Float[np.ndarray, "N 3"], pieces: tuple[ConvexPiece, ...], margin: float
) -> Bool[np.ndarray, "N"]:
    """Points within ``margin`` of a piece (by its face planes, and at its edges by its bounding box)."""
    inside = np.zeros(len(points), dtype=bool)
    for piece in pieces:
        near = np.flatnonzero(
            ((points >= piece.lower - margin) & (points <= piece.upper + margin)).all(axis=1) & ~inside
        )
        if len(near):
            faces = half_spaces(piece.vertices)
            inside[near] |= (points[near] @ faces[:, :3].T + faces[:, 3] <= margin).all(axis=1)
    return inside


def true_points(
    mesh_file: Path, origin: Float[np.ndarray, "3"], points: Float[np.ndarray, "N 3"]
) -> tuple[Float[np.ndarray, "M 3"], Callable[[Float[np.ndarray, "K 3"]], Float[np.ndarray, "K"]]]:
    """Where the true mesh stops the measured rays, and the distance of any place to that mesh."""
    import open3d as o3d

    tensor = o3d.core.Tensor.from_numpy
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(o3d.io.read_triangle_mesh(mesh_file)))
    length = np.linalg.norm(points - origin, axis=1)
    direction = (points - origin) / length[:, None]
    rays = np.column_stack([np.broadcast_to(origin, points.shape), direction]).astype(np.float32)
    hit = scene.cast_rays(tensor(rays))["t_hit"].numpy().astype(float)
    true = np.abs(hit - length) <= 0.05

    def distance(queries: Float[np.ndarray, "K 3"]) -> Float[np.ndarray, "K"]:
        return np.asarray(scene.compute_distance(tensor(queries.astype(np.float32))).numpy(), dtype=float)

    return origin + hit[true, None] * direction[true], distance


def ray_samples(cloud: Cloud, rng: np.random.Generator) -> Float[np.ndarray, "M 3"]:
    """Places along the rays, at 10 to 100 % of (range - 5 cm), above 5 cm and within the reach."""
    rays = cloud.points - cloud.origin
    length = np.linalg.norm(rays, axis=1, keepdims=True)
    fraction = rng.uniform(0.1, 1.0, size=(len(rays), 8))
    t = fraction * np.maximum(length - 0.05, 0.0) / length
    samples = (cloud.origin + t[:, :, None] * rays[:, None, :]).reshape(-1, 3)
    return np.asarray(samples[(samples[:, 2] > 0.05) & (np.hypot(samples[:, 0], samples[:, 1]) < REACH)])


def figures(perceived: Perceived, seen: Cloud, judge: Cloud, mesh_file: Path) -> tuple[float, float, float]:
    """Coverage within 1 cm and 2 cm, and false obstacle share, in percent."""
    surface, distance = true_points(mesh_file, seen.origin, seen.points)
    surface = surface[(surface[:, 2] > 0.03) & (np.hypot(surface[:, 0], surface[:, 1]) < REACH)]
    pieces = perceived.scene.pieces
    samples = ray_samples(judge, np.random.default_rng(5))
    hits = samples[inside_pieces(samples, pieces, 0.0)]
    n_false = int((distance(hits) > 0.02).sum()) if len(hits) else 0
    covered = [100.0 * float(inside_pieces(surface, pieces, margin).mean()) for margin in (0.01, 0.02)]
    return covered[0], covered[1], 100.0 * n_false / len(samples)


def pieces_table(folder: Path) -> None:
    """One row per scan of the scenes in ``folder``, and the targets."""
    print("scan                    points  cover 1 cm   2 cm  false %  pieces  verts  wall s  cpu s")
    spent = []
    for path in sorted((folder / "scenes").glob("*/scan*.pcd")):
        cloud = read_cloud(path)
        others = [other for other in sorted(path.parent.glob("scan*.pcd")) if other != path]
        if others:
            judge = read_cloud(others[0])
        else:
            withheld = np.random.default_rng(3).random(len(cloud.points)) < 0.2
            judge = Cloud(cloud.points[withheld], cloud.origin)
            cloud = Cloud(cloud.points[~withheld], cloud.origin)
        wall, cpu = time.perf_counter(), time.process_time()
        perceived = perceive(cloud, valve=False)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        one, two, false = figures(perceived, cloud, judge, path.parent / "gt.ply")
        pieces = perceived.scene.pieces
        most = max(len(piece.vertices) for piece in pieces)
        print(
            f"{path.parent.name + '/' + path.stem:22} {len(cloud.points):7d} {one:11.2f} {two:6.2f} {false:8.3f} "
            f"{len(pieces):7d} {most:6d} {wall:7.2f} {cpu:6.2f}"
        )
        spent.append(cpu)
    if spent:
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
        print(f"median {statistics.median(spent):.2f} s cpu (target {TARGET_CPU_S:g} s), peak memory {memory:.0f} MB")


def error_text(found: ValveDetection, centre: ArrayLike, axis: ArrayLike, outer_radius: float) -> str:
    """Errors of a detection against the truth."""
    direction = np.asarray(axis, dtype=float) / np.linalg.norm(np.asarray(axis, dtype=float))
    angle = np.degrees(np.arccos(np.clip(found.axis @ direction, -1.0, 1.0)))
    return (
        f"confidence {found.confidence:.2f}  centre {1e3 * np.linalg.norm(found.centre - np.asarray(centre)):4.1f} mm  "
        f"axis {angle:4.2f} deg  outer radius {1e3 * (found.outer_radius - outer_radius):+5.1f} mm"
    )


def valve_table(folder: Path) -> None:
    """Detection errors on the data folder's scans and on simulated ones, and false finds."""
    for path in sorted((folder / "scenes").glob("*/scan*.pcd")) + sorted((folder / "clouds").glob("*")):
        clock = time.perf_counter()
        found = detect_valves(read_cloud(path))
        seconds = time.perf_counter() - clock
        text = f"{sum(one.confidence >= CONFIDENT for one in found)} confident"
        truth = path.parent / "gt.json"
        valves = json.loads(truth.read_text()).get("valves", []) if truth.exists() else []
        if valves and found:
            text = error_text(found[0], valves[0]["centre"], valves[0]["axis"], valves[0]["outer_radius"])
        print(f"{path.parent.name + '/' + path.stem:40} {seconds:5.2f} s  {text}")
    rng = np.random.default_rng(11)
    for i in range(12):
        radius, tube = rng.uniform(0.08, 0.25), rng.uniform(0.008, 0.02)
        yaw, pitch = np.radians(rng.uniform([-35, -10], [35, 60]))
        axis = (-np.cos(yaw) * np.cos(pitch), -np.sin(yaw) * np.cos(pitch), np.sin(pitch))
        place = (rng.uniform(0.55, 0.8), rng.uniform(-0.4, 0.4), rng.uniform(0.8, 1.4))
        valve = Valve(place, axis, radius, tube, int(rng.integers(3, 7)), rng.uniform(0, 6), stem_length=0.25)
        room = Room(wall_x=1.1, pipes=((1.0, 0.7, 0.05),))
        found = detect_valves(scan(room.meshes() + valve.meshes(), Pose(pitch=0.3), seed=i))
        text = error_text(found[0], place, axis, valve.outer_radius) if found else "not found"
        print(f"simulated {i:2d}: radius {100 * radius:4.1f} cm, tube {1e3 * tube:4.1f} mm   {text}")


def main() -> None:
    """Print both tables; real scans need the data folder."""
    folder = Path(os.environ.get("SCOPT_DATA", Path(__file__).parents[2] / "shared" / "data"))
    pieces_table(folder)
    print()
    valve_table(folder)


if __name__ == "__main__":
    main()
