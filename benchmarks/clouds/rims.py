"""How well are the sizes of a wheel known where a peg goes?  Rims, spokes and hubs on simulated scans of drawn wheels.

From the checkout's root: ``python -m benchmarks.clouds.rims [--count 20] [--seed 0] [--variants dense camera]``.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from benchmarks.tables import print_table
from perception import ValveDetection, detect_valves
from perception.simulate import Valve
from perception.simulate.scenes import SimulatedScene
from perception.simulate.scenes.scene import assemble, cartons, floor, upright_pipe, wall
from perception.simulate.scenes.valves import PipedWheel, tilt_axis
from perception.solids.primitives import Mesh, lathe

_NEAR = 0.1  # of a hit's centre from its wheel [m]
_MEASURES = {"inner edge mm": 2.0, "outer edge mm": 2.0, "spokes deg": 2.0, "hub mm": 3.0}


def main(arguments: Sequence[str] | None = None) -> None:
    """Scan the drawn wheels and print the errors of each sensor."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=20, help="wheels")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--variants", nargs="+", default=("dense", "solid", "camera"), help="sensors, which take turns")
    chosen = parser.parse_args(arguments)
    errors: dict[tuple[str, str], list[float]] = defaultdict(list)
    counts: dict[str, list[int]] = defaultdict(lambda: [0, 0, 0])
    for i, (wheel, scene) in enumerate(draw(chosen.count, chosen.seed)):
        variant = chosen.variants[i % len(chosen.variants)]
        counts[variant][0] += 1
        hits = [hit for hit in detect_valves(scene.scan(variant)) if _is_of(hit, wheel)]
        if not hits:
            print(scene.name, variant, "not found")
            continue
        counts[variant][1] += 1
        counts[variant][2] += len(hits[0].spoke_angles) == wheel.n_spokes
        found = measure(hits[0], wheel)
        for name, value in found.items():
            errors[name, variant].append(value)
        shown = ", ".join(f"{name} {value:+.1f}" for name, value in found.items())
        print(f"{scene.name} {variant}: outer {1e3 * wheel.outer_radius:.0f} mm, {shown}", flush=True)
    rows = [
        (
            name,
            variant,
            str(len(values)),
            f"{np.median(values):+.1f}",
            f"{np.median(np.abs(values)):.1f}",
            f"{np.max(np.abs(values)):.1f}",
            f"{np.sum(np.abs(values) <= _MEASURES[name])}",
        )
        for (name, variant), values in sorted(errors.items())
    ]
    print_table("sizes of wheels", ("error", "scan", "wheels", "median", "|median|", "|worst|", "within target"), rows)
    rows = [(variant, *(str(value) for value in three)) for variant, three in counts.items()]
    print_table("wheels", ("scan", "drawn", "found", "all spokes"), rows)


def draw(count: int, seed: int) -> Iterator[tuple[Valve, SimulatedScene]]:
    """Yield wheels, each in a scene."""
    for i in range(count):
        rng = np.random.default_rng([seed, i])
        outer, tube = rng.uniform(0.06, 0.2), rng.uniform(0.007, 0.016)
        centre = (rng.uniform(0.6, 0.85), rng.uniform(-0.1, 0.1), rng.uniform(1.0, 1.3))
        axis = tilt_axis(rng.uniform(-15.0, 15.0), rng.uniform(-10.0, 25.0))
        hub, n_spokes, stem = rng.uniform(0.15, 0.3) * outer, int(rng.integers(3, 7)), rng.uniform(0.12, 0.2)
        spoke = rng.uniform(0.4, 0.7) * tube
        ring = (outer - tube, tube, n_spokes, rng.uniform(0.0, 2.0))
        wheel = Valve(centre, axis, *ring, spoke, max(hub, 0.018), max(0.1 * outer, 0.01), stem)
        valve = PipedWheel(wheel, (0.0, 0.3, 1.0), 0.04).build()
        if i % 2:
            # A rim that is broader than deep, or deeper: round rims hide errors of the section.
            half_depth = rng.uniform(0.007, 0.016)
            wheel = replace(wheel, rim_radius=outer - (width := rng.uniform(0.008, 0.022)), tube_radius=width)
            spare = replace(wheel, tube_radius=0.002)
            valve = PipedWheel(spare, (0.0, 0.3, 1.0), 0.04).build()
            valve = replace(valve, meshes=(*valve.meshes, _rim(wheel, half_depth)))
        face = centre[0] - stem * axis[0] + 0.25
        parts = [valve, floor(), wall(face)]
        parts += [upright_pipe(face - 0.1, centre[1] + 0.6, 0.05), *cartons(rng, 2, (face - 0.4, -1.2), 0.25)]
        yield wheel, assemble(f"wheel_{i}", seed, parts, centre)


def _rim(wheel: Valve, half_depth: float) -> Mesh:
    """Return a rim whose section is an ellipse."""
    angle = np.linspace(0.0, 2.0 * np.pi, 17)
    section = [(wheel.rim_radius + wheel.tube_radius * np.cos(a), half_depth * np.sin(a)) for a in angle]
    return lathe([*section[:-1], section[0]], wheel.centre, wheel.axis, 72)


def measure(hit: ValveDetection, wheel: Valve) -> dict[str, float]:
    """Return the errors of a hit's sizes: radii as found less true [mm], and its worst spoke's angle [deg]."""
    inner, hub = wheel.rim_radius - wheel.tube_radius, wheel.hub_radius
    found = {
        "inner edge mm": 1e3 * (hit.rim_radius - hit.tube_radius - inner),
        "outer edge mm": 1e3 * (hit.outer_radius - wheel.outer_radius),
        "hub mm": 1e3 * (hit.hub_radius - hub),
    }
    if hit.spoke_angles:
        apart = np.subtract.outer(np.array(hit.spoke_angles), np.array(wheel.spoke_angles))
        turned = np.degrees((apart + np.pi) % (2.0 * np.pi) - np.pi)
        nearest = np.abs(turned).argmin(axis=1)
        off = turned[np.arange(len(turned)), nearest]
        found["spokes deg"] = float(off[int(np.argmax(np.abs(off)))])
    return found


def _is_of(hit: ValveDetection, wheel: Valve) -> bool:
    return bool(np.linalg.norm(hit.centre - wheel.centre) < _NEAR) and hit.confidence > 0.0


if __name__ == "__main__":
    main()
