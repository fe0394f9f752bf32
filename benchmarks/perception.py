"""Coverage, false obstacles, pieces, time and detection errors of perception, printed as a table.

Coverage: share of true surface points (3 cm above the floor, within 3 m) within 1 cm of the pieces.
False obstacle: share of samples along rays of another scan (or of a fifth of the rays, withheld) that lie inside a
piece and more than 2 cm from any true surface.  True points: the ground-truth mesh hit by each measured ray.
"""

from __future__ import annotations

import json
import os
import time
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from costs.scene import ConvexPiece
from perception.clean import half_spaces
from perception.cloud import Cloud
from perception.perceive import Perceived, perceive
from perception.read import read_cloud

REACH = 3.0


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


def true_points(mesh_file: Path, origin: Float[np.ndarray, "3"], points: Float[np.ndarray, "N 3"]):
    """Where the true mesh stops the measured rays, and an oracle of distance to that mesh."""
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(o3d.io.read_triangle_mesh(str(mesh_file))))
    length = np.linalg.norm(points - origin, axis=1)
    direction = (points - origin) / length[:, None]
    rays = np.column_stack([np.broadcast_to(origin, points.shape), direction]).astype(np.float32)
    hit = scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy().astype(float)
    true = np.abs(hit - length) <= 0.05
    surface = origin + hit[true, None] * direction[true]

    def distance(queries: Float[np.ndarray, "M 3"]) -> Float[np.ndarray, "M"]:
        return scene.compute_distance(o3d.core.Tensor(queries.astype(np.float32))).numpy().astype(float)

    return surface, distance


def ray_samples(cloud: Cloud, rng: np.random.Generator) -> Float[np.ndarray, "M 3"]:
    """Places along the rays, at 10 to 100 % of (range - 5 cm), above 5 cm and within the reach."""
    rays = cloud.points - cloud.origin
    length = np.linalg.norm(rays, axis=1, keepdims=True)
    fraction = rng.uniform(0.1, 1.0, size=(len(rays), 8))
    t = fraction * np.maximum(length - 0.05, 0.0) / length
    samples = (cloud.origin + t[:, :, None] * rays[:, None, :]).reshape(-1, 3)
    return samples[(samples[:, 2] > 0.05) & (np.hypot(samples[:, 0], samples[:, 1]) < REACH)]


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


def main() -> None:
    """Print one row per scene of the shared data."""
    folder = Path(os.environ.get("SCOPT_DATA", Path(__file__).parents[1].parent / "shared" / "data"))
    print(
        f"{'scene':22} {'points':>7} {'cover 1cm':>9} {'2cm':>7} {'false %':>8} {'pieces':>6} {'verts':>5} {'wall s':>6} {'cpu s':>6}"
    )
    for scene in sorted((folder / "scenes").glob("*/scan*.pcd")):
        cloud = read_cloud(scene)
        others = [path for path in sorted(scene.parent.glob("scan*.pcd")) if path != scene]
        judge = read_cloud(others[0]) if others else cloud
        if not others:
            withheld = np.random.default_rng(3).random(len(cloud.points)) < 0.2
            judge = Cloud(cloud.points[withheld], cloud.origin)
            cloud = Cloud(cloud.points[~withheld], cloud.origin)
        clock, cpu = time.perf_counter(), time.process_time()
        perceived = perceive(cloud, valve=False)
        wall, cpu = time.perf_counter() - clock, time.process_time() - cpu
        one, two, false = figures(perceived, cloud, judge, scene.parent / "gt.ply")
        pieces = perceived.scene.pieces
        most = max(len(piece.vertices) for piece in pieces)
        print(
            f"{scene.parent.name + '/' + scene.stem:22} {len(cloud.points):7d} {one:9.2f} {two:7.2f} {false:8.3f} "
            f"{len(pieces):6d} {most:5d} {wall:6.2f} {cpu:6.2f}"
        )
        print("     ", {key: round(value, 2) for key, value in perceived.timings.items()})


if __name__ == "__main__":
    main()
