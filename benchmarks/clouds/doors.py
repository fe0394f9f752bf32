"""Errors of the geometry of simulated doors, as a planner of door openings reads it.

One scan per door: both sides and both hinge sides; levers level and turned down by 25 degrees, pull handles, push
bars; shut and ajar by 8 and 20 degrees; sizes, place, gaps and casings at random.  Doors ``deep`` stand back in their
wall on their pull side.  The hinge axis is judged with the true opening direction where the scan does not show it; a
hinge side that the scan does not show is ``?``.  The last row is a recorded scan, of the folder ``SCOPT_DATA``
(default: ``../shared/data``).

From the checkout's root: ``python -m benchmarks.clouds.doors [--sensor sparse] [--only TEXT] [--seed N] [--back M]``.
"""

from __future__ import annotations

import argparse
import json
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields

import numpy as np

from benchmarks.clouds.cases import data_folder
from benchmarks.tables import print_table
from perception import CONFIDENT, Detection, choose_opening, detect, make_view, read_cloud, read_door
from perception.detect.door.geometry import UP, DoorGeometry, HandleGeometry
from perception.simulate import DepthCamera, Pose, Scanner, SolidState, box, scan
from perception.simulate.scenes.doors import Door, Furniture, truth_geometry
from perception.simulate.sensor import Sensor

SENSORS: Mapping[str, Sensor] = {
    "dense": Scanner(),
    "sparse": Scanner(n_lines=44, sigma=0.015),
    "solid": SolidState(),
    # Pixels that err together over 5 cm, by 1 to 2 cm at 2 m.
    "stereo": DepthCamera(640, 480, 69.0, baseline=0.05, matching=0.09, correlation=3.0),
}
_AROUND = [box((-6.0, -6.0, -0.1), (6.0, 6.0, 0.0)), box((3.8, -4.0, 0.0), (3.9, 4.0, 2.6))]
_RECORDED = "recorded door_a"


@dataclass(frozen=True)
class Errors:
    """Errors of one door; NaN where the scan does not show the quantity.

    Attributes:
        hinge: distance of the hinge axes [mm].
        width: of the leaf [mm].
        normal, ajar: angle [deg].
        handle: distance of the handles' centres [mm].
        turn: angle by which the lever is turned down [deg].
        bar: angle between the handles' bars [deg].
        length, radius: of the bar [mm].
    """

    hinge: float
    width: float
    normal: float
    ajar: float
    handle: float
    turn: float
    bar: float
    length: float
    radius: float


def doors(seed: int) -> Iterator[tuple[str, Door]]:
    """Yield all doors by name."""
    for side in ("pull", "push"):
        for hinge_on in ("left", "right"):
            kinds: list[tuple[str, Furniture]] = [("lever", "lever"), ("lever 25", "lever")]
            kinds.append(("pull", "pull") if side == "pull" else ("bar", "bar"))
            for kind, furniture in kinds:
                for ajar in (0.0, 8.0, 20.0):
                    name = f"{side} {hinge_on} {kind} ajar {ajar:.0f}"
                    yield name, _random_door(name, seed, side, hinge_on, furniture, kind, ajar)
            if side == "pull":
                for recess in (0.03, 0.07):
                    name = f"{side} {hinge_on} lever deep {1e3 * recess:.0f}"
                    yield name, _random_door(name, seed, side, hinge_on, "lever", "lever", 0.0, recess)


def _random_door(
    name: str,
    seed: int,
    side: str,
    hinge_on: str,
    furniture: Furniture,
    kind: str,
    ajar_deg: float,
    recess: float = 0.0,
) -> Door:
    rng = np.random.default_rng([zlib.crc32(name.encode()), seed])
    width = rng.uniform(0.7, 1.1)
    along = (-0.5 if hinge_on == "left" else 0.5) * np.pi + np.radians(rng.uniform(-15.0, 15.0))
    middle = np.array([rng.uniform(0.85, 1.3), rng.uniform(-0.15, 0.15)])
    hinge = middle - 0.5 * width * np.array([np.cos(along), np.sin(along)])
    return Door(
        (hinge[0], hinge[1]),
        along,
        hinge_on,  # type: ignore[arg-type]
        side,  # type: ignore[arg-type]
        np.radians(ajar_deg),
        width,
        furniture=furniture,
        handle_z=rng.uniform(0.95, 1.1),
        backset=rng.uniform(0.055, 0.09),
        lever_length=rng.uniform(0.1, 0.17),
        lever_turn=np.radians(25.0) if kind == "lever 25" else 0.0,
        handle_radius=rng.uniform(0.008, 0.0125),
        pull_length=rng.uniform(0.25, 0.5),
        standoff=rng.uniform(0.045, 0.065),
        wall_thickness=rng.uniform(0.1, 0.16),
        recess=recess,
        gap=rng.uniform(0.002, 0.006),
        reveal=rng.uniform(0.003, 0.012),
    )


def recorded_door() -> tuple[Detection | None, DoorGeometry] | None:
    """Return the best detection in the recorded scan, and its truth; None without the data."""
    folder = data_folder() / "scenes" / "door_a"
    if not (folder / "scan0.pcd").exists():
        return None
    truth = json.loads((folder / "gt.json").read_text())["door"]
    along = -np.array([0.0, np.sign(truth["hinge_point"][1]), 0.0])
    normal = np.array(truth["leaf_normal_to_robot"])
    parts = json.loads((folder / "gt.json").read_text())["parts"]
    lever, rose = (next(part for part in parts if part["name"] == f"door/handles/{name}") for name in ("ID17", "ID4"))
    # The hinges' knuckles stand on the robot's side, and the spindle is the middle of the rose.
    spindle = 0.5 * (np.array(rose["aabb_min"]) + np.array(rose["aabb_max"]))
    spindle[0] = lever["aabb_min"][0] + 0.01
    length = abs(spindle[1] - lever["aabb_min"][1])
    handle = HandleGeometry("lever", spindle, -along, length, 0.01)
    hinge = np.array([truth["leaf_face_point"][0], truth["hinge_point"][1], 0.0])
    sizes = truth["leaf_width"], truth["leaf_height"], truth["leaf_thickness"]
    geometry = DoorGeometry(hinge, along, normal, 0.0, *sizes, "pull", 0.0, handle)
    hits = detect("door", make_view(read_cloud(folder / "scan0.pcd")))
    return (hits[0] if hits else None), geometry


def detect_best(door: Door, sensor: Sensor, seed: int, back: float = 0.0) -> Detection | None:
    """Return the best detection of a scan of the door, None without one.

    Args:
        back: distance by which the sensor stands behind the robot's head [m].
    """
    cloud = scan([*door.build().meshes, *_AROUND], Pose((0.1 - back, 0.0, 1.62), pitch=0.3), sensor, seed)
    return next(iter(detect("door", make_view(cloud))), None)


def compare(found: DoorGeometry, truth: DoorGeometry) -> Errors:
    """Return the errors of a geometry whose hinges are on the true side."""
    if found.opens is None and truth.opens is not None:
        found = choose_opening(found, truth.opens)
    hinge = 1e3 * float(np.linalg.norm((found.hinge - truth.hinge)[:2]))
    leaf = hinge, 1e3 * abs(found.width - truth.width), _angle(found.normal, truth.normal)
    ajar, turn = (float(np.degrees(abs(a))) for a in (found.ajar - truth.ajar, found.handle_turn - truth.handle_turn))
    one, other = found.handle, truth.handle
    if one is None or other is None or one.kind != other.kind:
        return Errors(*leaf, ajar, *[np.nan] * 5)
    apart = 1e3 * float(np.linalg.norm(one.centre - other.centre))
    seen, true = (_seen_bar(geometry) for geometry in (found, truth))
    lengths = 1e3 * abs(one.length - other.length), 1e3 * abs(one.radius - other.radius)
    is_lever = other.kind == "lever"
    return Errors(*leaf, ajar, apart, turn if is_lever else np.nan, _angle(seen, true), *lengths)


def _seen_bar(geometry: DoorGeometry) -> np.ndarray:
    """Return the direction of the bar as it was seen on the shut leaf, a lever turned down."""
    handle = geometry.handle
    assert handle is not None
    turn = geometry.handle_turn
    return np.asarray(np.cos(turn) * handle.direction - np.sin(turn) * UP)


def _angle(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.degrees(np.arccos(np.clip(one @ other, -1.0, 1.0))))


def _judge(found: object, true: object) -> str:
    return "?" if found is None else "right" if found == true else f"WRONG ({found})"


def main() -> None:
    """Print the table of one sensor."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--sensor", choices=tuple(SENSORS), default="dense")
    parser.add_argument("--only", default="", help="part of the names of the doors")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--back", type=float, default=0.0, help="distance of the sensor behind the robot's head [m]")
    chosen = parser.parse_args()
    cases = [
        (name, detect_best(door, SENSORS[chosen.sensor], chosen.seed, chosen.back), truth_geometry(door))
        for name, door in doors(chosen.seed)
        if chosen.only in name
    ]
    recorded = recorded_door() if chosen.only in _RECORDED else None
    if recorded is not None:
        cases.append((_RECORDED, *recorded))
    rows, values, verdicts = [], [], []
    for name, hit, truth in cases:
        if hit is None:
            rows.append([name, "-", *["?"] * 3, *["-"] * len(fields(Errors))])
            continue
        found = read_door(hit)
        is_side_known = hit.residuals["hinge_share"] > 0.0
        is_side_right = bool(found.along @ truth.along > 0.0)
        kind = found.handle.kind if found.handle is not None else None
        verdict = (
            _judge(kind, truth.handle.kind if truth.handle is not None else None),
            _judge(is_side_right if is_side_known else None, True).replace(" (False)", ""),
            _judge(found.opens, truth.opens),
        )
        errors = compare(found, truth) if is_side_right else Errors(*[np.nan] * len(fields(Errors)))
        row = [getattr(errors, field.name) for field in fields(Errors)]
        rows.append([name, f"{hit.confidence:.2f}", *verdict, *("-" if np.isnan(x) else f"{x:.1f}" for x in row)])
        if name != _RECORDED:
            values.append(row)
            verdicts.append(verdict)
    header = ["door", "conf", "kind", "hinge side", "opens"]
    header += [
        "hinge mm",
        "width mm",
        "normal deg",
        "ajar deg",
        "handle mm",
        "turn deg",
        "bar deg",
        "length mm",
        "radius mm",
    ]
    if values:
        table = np.array(values)
        for name, quantile in (("median", 50.0), ("90 %", 90.0), ("largest", 100.0)):
            known = [column[~np.isnan(column)] for column in table.T]
            figures = [f"{np.percentile(column, quantile):.1f}" if len(column) else "-" for column in known]
            rows.append([f"{name} of {len(values)} simulated", "", "", "", "", *figures])
        counts = [
            f"{sum(v[k] == 'right' for v in verdicts)} right, {sum(v[k] == '?' for v in verdicts)} ?" for k in range(3)
        ]
        sure = sum(hit is not None and hit.confidence >= CONFIDENT for _, hit, _ in cases)
        rows.append([f"confident {sure} of {len(cases)}", "", *counts, *[""] * len(fields(Errors))])
    print_table(f"Doors, {chosen.sensor} scans", header, rows)


if __name__ == "__main__":
    main()
