"""How long a new scan of a scene takes that was perceived before, and how many of its pieces stay the same objects.

``again``: the same scene with other noise; ``taken``: its last thing taken away; ``aside``: seen from 40 cm aside.
From the checkout's root: ``python -m benchmarks.cloud_update [--only NAME] [--seed N]``.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping

from benchmarks.tables import Samples, print_table
from perception import Cloud, perceive, update
from perception.simulate import DepthCamera, Scanner, SolidState, scan
from perception.simulate.scenes import make_scene
from perception.simulate.sensor import Sensor

_SCENES = ("debris_large_heap", "empty_workshop", "valve_manifold")
_SENSORS: Mapping[str, Sensor] = {
    "spinning 45k": Scanner(n_lines=60),
    "spinning 90k": Scanner(n_lines=120),
    "spinning 200k": Scanner(n_lines=290),
    "solid 200k": SolidState(n_points=200_000),
    "camera 200k": DepthCamera(width=640, height=320),
}
_RUNS = 3


def changes(name: str, sensor: Sensor, seed: int) -> Iterator[tuple[str, Cloud]]:
    """The first scan of a scene and those after it, the rays that met nothing included."""
    scene = make_scene(name, seed)
    for noise, (change, meshes, pose) in enumerate(
        (
            ("first", scene.meshes, scene.poses[0]),
            ("again", scene.meshes, scene.poses[0]),
            ("taken", scene.meshes[:-1], scene.poses[0]),
            ("aside", scene.meshes, scene.poses[1]),
        )
    ):
        yield change, scan(meshes, pose, sensor, seed=noise, misses=True)


def rows(only: str, seed: int) -> Iterator[tuple[str, ...]]:
    """One for each scene, sensor and change."""
    for name in _SCENES:
        for kind, sensor in _SENSORS.items():
            if only not in f"{name} {kind}":
                continue
            (_, first), *others = changes(name, sensor, seed)
            before = perceive(first, valve=False)
            old = {id(piece) for piece in before.scene.pieces}
            for change, cloud in others:
                samples = Samples()
                for _ in range(_RUNS):
                    after = samples.measure(update, before, cloud)
                n_kept = len(old & {id(piece) for piece in after.scene.pieces})
                yield (
                    f"{name} {kind} {change}",
                    str(len(cloud.points)),
                    str(len(cloud.misses)),
                    f"{min(samples.cpu):.2f}",
                    f"{min(samples.wall):.2f}",
                    str(len(before.scene.pieces)),
                    str(n_kept),
                    str(len(after.scene.pieces) - n_kept),
                )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="part of the name of scene and sensor")
    parser.add_argument("--seed", type=int, default=0, help="of the scenes' details")
    asked = parser.parse_args()
    print_table(
        f"A new scan of the same scene, best of {_RUNS}",
        ("scan", "points", "no return", "CPU [s]", "wall [s]", "pieces", "kept", "new"),
        list(rows(asked.only, asked.seed)),
    )


if __name__ == "__main__":
    main()
