"""Time of updating a known scene with a new scan, number of pieces that stay, and their quality.

``again``: the same scene with other noise; ``taken``: its last thing taken away; ``aside``: seen from 40 cm aside;
``in turn``: the last of five scans, from aside and from where the first was taken.

Coverage and false obstacle: as ``benchmarks.clouds.pieces`` judges, against 20,000 places where the measured rays meet
the true mesh and along 20,000 rays of a scan from the other of the two places.  The last column names the targets
missed: coverage, false obstacle and pieces of ``benchmarks.clouds.pieces``, and half a second.

From the checkout's root: ``python -m benchmarks.clouds.update [--only NAME] [--seed N]``.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.clouds.pieces import Figures, Targets, Union, ray_samples, true_points
from benchmarks.clouds.worker import Made
from benchmarks.tables import Samples, print_table
from perception import Cloud, Perceived, perceive, update
from perception.simulate import Caster, DepthCamera, Mesh, Scanner, SolidState, join_meshes, scan
from perception.simulate.scenes import SimulatedScene, make_scene
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
_JUDGED = 20_000
_JUDGING = 11  # seed of the noise of the scan that judges


@dataclass(frozen=True)
class Change:
    """A change of a scene.

    Attributes:
        name: of the change.
        meshes: of the scene after the change.
        poses: sensor poses of the scans since the first, by number.
    """

    name: str
    meshes: Sequence[Mesh]
    poses: tuple[int, ...]


def changes_of(scene: SimulatedScene) -> Iterator[Change]:
    """Yield all measured changes of a scene."""
    yield Change("again", scene.meshes, (0,))
    yield Change("taken", scene.meshes[:-1], (0,))
    yield Change("aside", scene.meshes, (1,))
    yield Change("in turn", scene.meshes, (1, 0, 1, 0, 1))


def judged(after: Perceived, cloud: Cloud, judge: Cloud, surface: Caster, samples: Samples) -> Figures:
    """Measure the pieces after an update by the rays of another scan."""
    rng = np.random.default_rng(3)
    pieces = tuple(piece.vertices for piece in after.scene.pieces)
    union, reach = Union(pieces), after.view.reach
    true = true_points(surface, _some(cloud, rng))
    true = true[(true[:, 2] > 0.03) & reach.contains(true)]
    cover_1, cover_2 = (100.0 * float(union.within(true, margin).mean()) for margin in (0.01, 0.02))
    false = union.false_share(ray_samples(_some(judge, rng), reach.radius, rng), surface.distance)
    made = Made(pieces, min(samples.wall), min(samples.cpu), np.nan)
    most = max(len(vertices) for vertices in pieces)
    return Figures(len(cloud.points), cover_1, cover_2, false, len(pieces), most, made)


def _some(cloud: Cloud, rng: np.random.Generator) -> Cloud:
    n_points = len(cloud.points)
    return cloud.select(rng.choice(n_points, min(_JUDGED, n_points), replace=False))


def rows(only: str, seed: int) -> Iterator[tuple[str, ...]]:
    """Yield one row for each scene, sensor and change."""
    for name in _SCENES:
        targets = Targets(pieces=250 if name.startswith("debris") else 150, seconds=0.5)
        for kind, sensor in _SENSORS.items():
            scene = make_scene(name, seed)
            chosen = [change for change in changes_of(scene) if only in f"{name} {kind} {change.name}"]
            if not chosen:
                continue
            first = perceive(scan(scene.meshes, scene.poses[0], sensor, seed=0, misses=True))
            for change in chosen:
                before, samples = first, Samples()
                *earlier, cloud = (
                    scan(change.meshes, scene.poses[pose], sensor, seed=noise, misses=True)
                    for noise, pose in enumerate(change.poses, start=1)
                )
                for one in earlier:
                    before = update(before, one)
                for _ in range(_RUNS):
                    after = samples.measure(update, before, cloud)
                judge = scan(change.meshes, scene.poses[1 - change.poses[-1]], sensor, seed=_JUDGING)
                figures = judged(after, cloud, judge, Caster(join_meshes(change.meshes)), samples)
                n_kept = len({id(piece) for piece in before.scene.pieces} & {id(piece) for piece in after.scene.pieces})
                yield (
                    f"{name} {kind} {change.name}",
                    str(len(cloud.points)),
                    str(len(cloud.misses)),
                    f"{figures.cover_1:.2f}",
                    f"{figures.cover_2:.2f}",
                    f"{figures.false:.3f}",
                    f"{figures.made.cpu:.2f}",
                    f"{figures.made.wall:.2f}",
                    str(len(before.scene.pieces)),
                    str(n_kept),
                    str(len(after.scene.pieces) - n_kept),
                    figures.missed(targets),
                )


HEADER = (
    "scan", "points", "no return", "cover 1 cm", "2 cm", "false %", "cpu s", "wall s",
    "pieces", "kept", "new", "misses",
)  # fmt: skip


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="part of the name of scene, sensor and change")
    parser.add_argument("--seed", type=int, default=0, help="of the scenes' details")
    asked = parser.parse_args()
    table: list[tuple[str, ...]] = []
    for row in rows(asked.only, asked.seed):
        # The table comes last; rows are printed as they are measured.
        print("  ".join(row), file=sys.stderr)
        table.append(row)
    n_met = sum(not row[-1] for row in table)
    print_table(
        f"A new scan of the same scene, best of {_RUNS}: {n_met} of {len(table)} meet all targets", HEADER, table
    )


if __name__ == "__main__":
    main()
