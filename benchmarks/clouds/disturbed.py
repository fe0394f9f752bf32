"""Are the same objects found when a scan is disturbed?  Confidence and place, with a scan as it is and as it might be.

Sensor 5 cm off, noise twice, a quarter of the points, tilted by 3 deg; and what should change nothing: noise of 1e-9 m,
another order of the points, a turn of axes and back.  Hits that are confident in the scan as it is are followed.

From the checkout's root: ``python -m benchmarks.clouds.disturbed [--real FOLDER] [--seed 900] [--only NAME]``.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from benchmarks.clouds.cases import Case, data_folder, simulated_cases
from benchmarks.clouds.confidence import list_recorded
from benchmarks.tables import print_table
from perception import CONFIDENT, Cloud, Detection, detect, make_view
from perception.noise import estimate_noise

_SAME = 0.2  # between origins of one object [m]
_PLACE_MM, _LOOSE, _TIGHT = 5.0, 0.1, 0.02
_SCENES = ("valve_plain", "valve_lever", "drill_shelf", "lever_box", "door_left_shut")
Change = Callable[[Cloud, np.random.Generator], tuple[Cloud, Float[np.ndarray, "4 4"]]]


def main(arguments: Sequence[str] | None = None) -> None:
    """Disturb the scans and print how far confidences and places move."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--real", type=Path, default=data_folder() / "real", help="folder of recorded clouds")
    parser.add_argument("--seed", type=int, default=900, help="of simulated scenes")
    parser.add_argument("--only", default="", help="only scans whose name holds one of these, separated by commas")
    chosen = parser.parse_args(arguments)
    moved: dict[str, list[tuple[float, float]]] = defaultdict(list)
    for case in _list_cases(chosen.real, chosen.seed):
        if any(part in case.name for part in chosen.only.split(",")):
            for name, by, off_mm, text in follow(case):
                moved[name].append((by, off_mm))
                print(case.name, name, text, flush=True)
    rows = []
    for name, values in moved.items():
        by, off = np.array(values).T
        most = _LOOSE if name in LOOSE else _TIGHT
        rows.append(
            (
                name,
                str(len(by)),
                f"{np.median(by):.3f}",
                f"{by.max():.2f}",
                f"{(by <= most).sum()}",
                f"{np.nanmax(off, initial=0.0):.1f}",
                f"{(off <= _PLACE_MM).sum()}",
            )
        )
    columns = (
        "disturbance",
        "objects",
        "confidence: median",
        "worst",
        "within target",
        "place: worst mm",
        "within 5 mm",
    )
    print_table("disturbed scans", columns, rows)


def follow(case: Case) -> Iterator[tuple[str, float, float, str]]:
    """Yield, for each disturbance and each confident hit, how far confidence and place move [mm], and both as text."""
    cloud = case.load()
    for kind in sorted({truth.kind for truth in case.truth}):
        sure = [hit for hit in detect(kind, make_view(cloud, reach=case.reach)) if hit.confidence >= CONFIDENT]
        if not sure:
            continue
        for name, change in {**LOOSE, **TIGHT}.items():
            other, move = change(cloud, np.random.default_rng(0))
            hits = detect(kind, make_view(other, reach=case.reach))
            for hit in sure:
                yield name, *_compare(hit, hits, move)


def _compare(hit: Detection, hits: Sequence[Detection], move: Float[np.ndarray, "4 4"]) -> tuple[float, float, str]:
    """Return the change of confidence and of place [mm] of a hit; no place where it is lost."""
    place = (move @ hit.pose_world_object)[:3, 3]
    near = [(float(np.linalg.norm(one.pose_world_object[:3, 3] - place)), one) for one in hits]
    near = [(off, one) for off, one in near if off < _SAME]
    if not near:
        return hit.confidence, np.nan, f"{hit.kind} {hit.confidence:.3f} lost"
    off, one = max(near, key=lambda pair: pair[1].confidence)
    text = f"{hit.kind} {hit.confidence:.3f} -> {one.confidence:.3f}, {1e3 * off:.1f} mm"
    return abs(one.confidence - hit.confidence), 1e3 * off, text


def _list_cases(real: Path, seed: int) -> Iterator[Case]:
    recorded = (case for case, _, _ in list_recorded(real, moves=(0,)) if case.truth) if real.is_dir() else ()
    simulated = (case for case in simulated_cases(("dense/solid/camera",), seed) if case.name.split(":")[0] in _SCENES)
    return chain(recorded, simulated)


def _shift_sensor(cloud: Cloud, rng: np.random.Generator) -> tuple[Cloud, Float[np.ndarray, "4 4"]]:
    way = rng.normal(size=3)
    return Cloud(cloud.points, cloud.origin + 0.05 * way / np.linalg.norm(way)), np.eye(4)


def _add_noise(cloud: Cloud, rng: np.random.Generator) -> tuple[Cloud, Float[np.ndarray, "4 4"]]:
    starts, ends = cloud.starts, cloud.points
    along = ends - starts
    far = np.linalg.norm(along, axis=1, keepdims=True)
    # Three times the variance is added to what is there.
    spread = np.sqrt(3.0) * estimate_noise(cloud).sigma(far)
    return Cloud(ends + along / far * spread * rng.normal(size=far.shape), starts), np.eye(4)


def _keep_quarter(cloud: Cloud, rng: np.random.Generator) -> tuple[Cloud, Float[np.ndarray, "4 4"]]:
    keep = np.sort(rng.permutation(len(cloud.points))[: len(cloud.points) // 4])
    starts, ends = cloud.starts, cloud.points
    return Cloud(ends[keep], starts[keep]), np.eye(4)


def _tilt(cloud: Cloud, rng: np.random.Generator) -> tuple[Cloud, Float[np.ndarray, "4 4"]]:
    way = rng.uniform(0.0, 2.0 * np.pi)
    move = np.eye(4)
    move[:3, :3] = Rotation.from_rotvec(np.radians(3.0) * np.array([np.cos(way), np.sin(way), 0.0])).as_matrix()
    return Cloud(cloud.points @ move[:3, :3].T, cloud.origin @ move[:3, :3].T), move


def _round(cloud: Cloud, rng: np.random.Generator) -> tuple[Cloud, Float[np.ndarray, "4 4"]]:
    return Cloud(cloud.points + 1e-9 * rng.normal(size=cloud.points.shape), cloud.origin), np.eye(4)


def _shuffle(cloud: Cloud, rng: np.random.Generator) -> tuple[Cloud, Float[np.ndarray, "4 4"]]:
    order = rng.permutation(len(cloud.points))
    starts, ends = cloud.starts, cloud.points
    return Cloud(ends[order], starts[order]), np.eye(4)


def _turn_and_back(cloud: Cloud, rng: np.random.Generator) -> tuple[Cloud, Float[np.ndarray, "4 4"]]:
    turn = Rotation.random(rng=rng).as_matrix()
    return Cloud(cloud.points @ turn.T @ turn, cloud.origin @ turn.T @ turn), np.eye(4)


LOOSE: Mapping[str, Change] = {
    "sensor 5 cm off": _shift_sensor,
    "noise twice": _add_noise,
    "25 % of the points": _keep_quarter,
    "tilt 3 deg": _tilt,
}
TIGHT: Mapping[str, Change] = {"noise 1e-9 m": _round, "order": _shuffle, "turned and back": _turn_and_back}


if __name__ == "__main__":
    main()
