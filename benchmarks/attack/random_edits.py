"""Random edits: one number of a result folder changed by a relevant amount, the rest made consistent.

The edited part decides which judge is used.  Pieces, promises, samples and movables are stated elsewhere too (in the
request, on the curve), so a folder with other values must not be certified.  An edited motion or demand may still be
met: then dense samples, pinocchio and coal's exact shapes decide (only for the arm, whose shapes
:mod:`benchmarks.attack.truth` reads).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.attack import bases, judges
from benchmarks.attack.arm_files import honest_urdf
from benchmarks.attack.forgery import Folder, Level
from benchmarks.attack.outcome import Answer, Attack
from benchmarks.attack.truth import Truth
from costs.curve import Curve

LEAST, MOST = 3e-3, 0.3  # by which a number is moved [m, rad, s]
REACHED, STARTED = 2e-3, 2e-3  # from goal and start a motion may end and begin [rad]
DEEPER_M = 5e-4
LOOSER = ("tolerance", "depth")  # made less strict, since a folder may promise more than is demanded
FREE = ("quaternion_wxyz", "rotation_tolerance_deg", "margin_m")


@dataclass(frozen=True)
class Part:
    """Numbers of a kind.

    Attributes:
        name: of the part.
        bases: whose folders have it.
        root: where the numbers are.
        level: how much is made consistent.
        is_stated_twice: whether any change is false; else the true motion decides.
    """

    name: str
    bases: tuple[str, ...]
    root: Callable[[Folder], Any]
    level: Level
    is_stated_twice: bool


def _promises(folder: Folder) -> Any:
    return [[phase["contacts"], phase["allowances"], phase["targets"]] for phase in folder.phases]


PARTS = (
    Part("pieces", ("arm", "reach", "carry", "valve"), lambda f: f.data["pieces"], Level.REMADE, True),
    Part("promises", ("arm", "reach", "carry", "valve", "program"), _promises, Level.REMADE, True),
    Part("support", ("reach", "carry", "valve"), lambda f: [p["support"] for p in f.phases], Level.REMADE, True),
    Part("movables", ("valve",), lambda f: [m["bodies"] for m in f.data["movables"]], Level.REMADE, True),
    Part("wheel", ("valve",), lambda f: [[m["origin"], m["axis"]] for m in f.data["movables"]], Level.REMADE, True),
    Part("samples", ("arm", "reach", "valve", "untimed"), lambda f: f.data["trajectory"], Level.HASHED, True),
    Part("bodies", ("arm", "reach"), lambda f: f.data["bodies"], Level.RAW, True),
    Part("goal", ("arm", "untimed"), lambda f: f.request["goal"], Level.HASHED, False),
    Part("start", ("arm", "untimed"), lambda f: f.request["start"], Level.HASHED, False),
    Part("obstacles", ("arm", "untimed"), lambda f: f.request["scene"]["obstacles"], Level.HASHED, False),
    Part("knots", ("arm", "untimed"), lambda f: f.curve["positions"], Level.REMADE, False),
    Part("tangents", ("arm", "untimed"), lambda f: f.curve["tangents"], Level.REMADE, False),
)


def attacks(seed: int, count: int) -> list[Attack]:
    """Return that many random edits, of all parts in turn."""
    return [Attack("random", f"edit {index} of seed {seed}", partial(_run, seed, index)) for index in range(count)]


def _run(seed: int, index: int, scratch: Path) -> tuple[Answer, str]:
    rng = np.random.default_rng([seed, index])
    part = PARTS[index % len(PARTS)]
    base = str(rng.choice(part.bases))
    folder = Folder(bases.copy_of(base, scratch, is_drawn=False))
    leaves = list(_leaves(part.root(folder), ""))
    holder, key, where = leaves[int(rng.integers(len(leaves)))]
    before = float(holder[key])
    amount = math.exp(rng.uniform(math.log(LEAST), math.log(MOST))) * float(rng.choice([-1.0, 1.0]))
    if any(word in where for word in LOOSER):
        amount = abs(amount)
    if "polygon" in where:
        amount = math.copysign(amount, before)
    holder[key] = before + amount
    folder.save(part.level)
    answer, text = judges.verify(folder.path)
    text = f"{base}.{part.name}{where}: {before:.6g} -> {holder[key]:.6g}: {text}"
    if answer is Answer.BELIEVED and not part.is_stated_twice:
        wrong = _wrong(base, folder)
        return (Answer.BELIEVED, f"{text}, but {wrong}") if wrong else (Answer.TRUE, text)
    return answer, text


def _leaves(data: Any, path: str) -> Iterator[tuple[Any, Any, str]]:
    """Yield every relevant number as its container, its key there, and its path."""
    entries = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in entries:
        if key in FREE:
            continue
        if isinstance(value, float):
            yield data, key, f"{path}.{key}"
        yield from _leaves(value, f"{path}.{key}")


def _wrong(base: str, folder: Folder) -> str:
    """Return which demands of the folder's request a motion of the arm misses; empty if none."""
    curve = folder.curve
    path = Curve(*(np.array(curve[key], dtype=float) for key in ("knots", "positions", "tangents")))
    names, rows = curve["joint_names"], path(np.linspace(path.knots[0], path.knots[-1], 1500))
    for demand, row, most in (("goal", rows[-1], REACHED), ("start", rows[0], STARTED)):
        for name, value in folder.request[demand]["joints"].items():
            off = abs(float(row[names.index(name)]) - value)
            if off > most:
                return f"{name} is {off:.4f} rad off the {demand}"
    model = Truth(honest_urdf(), bases.original(base) / "files")
    low, high = model.model.lowerPositionLimit, model.model.upperPositionLimit
    if (rows < low - 1e-6).any() or (rows > high + 1e-6).any():
        return "a joint is beyond its limits"
    obstacles = folder.request["scene"]["obstacles"]
    depth = model.deepest(names, rows, obstacles, (("forearm", "hand"),))
    if depth.metres > DEEPER_M:
        return f"{' and '.join(depth.pair)} are {1e3 * depth.metres:.1f} mm inside each other"
    return ""
