"""Levelling: recorded depth clouds and simulated ones, turned by drawn rotations and by axis conventions.

``python -m benchmarks.clouds.levelling [--draws N] [--seed N]`` prints the angle between the direction upwards that is
found and the true one.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from benchmarks.clouds.cases import data_folder
from perception import Cloud, read_cloud
from perception.levelling.level import find_levelling
from perception.simulate.scenes import SCENES, make_scene

# Rotation from the world (x ahead, z up) to frames in use.
CONVENTIONS = {
    "z up": np.eye(3),
    "y up": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "camera": np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]),
    "OpenGL": np.array([[0.0, -1, 0], [0, 0, 1], [-1, 0, 0]]),
}
_TURNS_DEG = (5.0, 45.0)
_GOOD_DEG = 1.0


def list_recorded(folder: Path) -> Iterator[tuple[str, str, Cloud]]:
    """Yield source, name and cloud of the recorded clouds, z up."""
    for path in sorted(folder.glob("*.ply")):
        facts = json.loads(path.with_suffix(".json").read_text())
        yield f"real, {'depth' if is_depth(facts['sensor_type']) else 'laser'}", path.stem, read_cloud(path)


def is_depth(sensor: str) -> bool:
    """Return whether a recorded cloud's sensor is a depth camera."""
    return not any(word in sensor.lower() for word in ("velodyne", "laser", "scanner"))


def list_simulated(seed: int) -> Iterator[tuple[str, str, Cloud]]:
    """Yield simulated scans by a depth camera of every recipe."""
    for name in SCENES:
        yield "simulated, depth", name, make_scene(name, seed).scan("camera_sparse")


def turn(cloud: Cloud, rotation: Float[np.ndarray, "3 3"]) -> Cloud:
    """Return the cloud in its sensor's frame, turned."""
    start = np.atleast_2d(cloud.origin)[0]
    return Cloud((cloud.points - start) @ rotation.T, np.zeros(3))


def measure(cloud: Cloud, rng: np.random.Generator, n_draws: int) -> list[tuple[float, bool, float]]:
    """Return error [deg], whether it was sure, and processor time [s] of each turned copy."""
    results = []
    for k, axes in enumerate(np.tile(np.array(list(CONVENTIONS.values())), (n_draws, 1, 1))):
        axis = rng.normal(size=3)
        angle = np.radians(rng.uniform(*_TURNS_DEG)) if k >= len(CONVENTIONS) else 0.0
        rotation = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix() @ axes
        began = time.process_time()
        found = find_levelling(turn(cloud, rotation))
        spent = time.process_time() - began
        cosine = -1.0 if found is None else float(found.pose[2, :3] @ rotation[:, 2])
        error = float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
        results.append((error, found is not None and found.is_sure, spent))
    return results


def main() -> None:
    """Print a row per cloud and one per source."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=3, help="copies per convention; the first is turned by it alone")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    rng = np.random.default_rng(given.seed)
    rows: dict[str, list[tuple[float, bool, float]]] = {}
    clouds = chain(list_recorded(data_folder() / "real"), list_simulated(given.seed))
    for source, name, cloud in clouds:
        results = measure(cloud, rng, given.draws)
        rows.setdefault(source, []).extend(results)
        errors = np.array([error for error, _, _ in results])
        good = int((errors <= _GOOD_DEG).sum())
        print(
            f"{source:18} {name:24} within 1 deg {good}/{len(errors)}, median {np.median(errors):.2f} deg", flush=True
        )
    for source, results in rows.items():
        error, sure, spent = (np.array(column) for column in zip(*results, strict=True))
        print(
            f"{source}: within 1 deg {np.mean(error <= _GOOD_DEG):.3f}, within 3 deg {np.mean(error <= 3.0):.3f}, "
            f"wrong axis {np.mean(error > 20.0):.3f} (and sure {np.mean((error > 20.0) & sure):.3f}), "
            f"{np.mean(spent):.2f} CPU s, {len(error)} clouds"
        )


if __name__ == "__main__":
    main()
