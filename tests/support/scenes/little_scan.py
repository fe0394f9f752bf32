"""A little scan that is quick to look at: floor, a wall, a crate before it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from click.testing import Result
from typer.testing import CliRunner

from perception import Cloud, write_npz
from perception.simulate import Pose, Room, Scanner, scan
from service.cli.app import app

CRATE = ((1.0, -0.3, 0.0), (1.3, 0.2, 0.6))


def scopt(*arguments: object) -> Result:
    """What a command prints and how it ends."""
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def little_scan(shift: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Cloud:
    """Floor, a wall 1.5 m ahead and the front of a crate before it, seen from 1.6 m up, and all moved [m]."""
    rng = np.random.default_rng(0)
    floor = np.column_stack([rng.uniform(-1, 1.5, 2500), rng.uniform(-1.2, 1.2, 2500), rng.normal(0, 0.004, 2500)])
    wall = np.column_stack([rng.normal(1.5, 0.004, 2500), rng.uniform(-1.2, 1.2, 2500), rng.uniform(0, 2, 2500)])
    crate = np.column_stack([rng.normal(1.0, 0.004, 900), rng.uniform(-0.3, 0.2, 900), rng.uniform(0.0, 0.6, 900)])
    hidden = (wall[:, 2] < 0.55) & (np.abs(wall[:, 1] + 0.05) < 0.4)
    points = np.concatenate([floor, wall[~hidden], crate])
    return Cloud(points + shift, np.array([0.0, 0.0, 1.6]) + shift)


def crate_scan(path: Path, crate_y: float | None = 0.0, seed: int = 0) -> Path:
    """A simulated scan of a room with a crate, from above it, as an NPZ file.

    Args:
        path: of the file.
        crate_y: how far the crate stands to the left of ``CRATE`` [m]; None: it is not there.
        seed: of the noise.
    """
    lower, upper = CRATE
    boxes = (
        () if crate_y is None else (((lower[0], lower[1] + crate_y, 0.0), (upper[0], upper[1] + crate_y, upper[2])),)
    )
    room = Room(wall_x=1.8, boxes=boxes)
    write_npz(path, scan(room.meshes(), Pose((0.1, 0.0, 1.6), pitch=0.4), Scanner(n_lines=60, sigma=0.004), seed=seed))
    return path


def box_obj(path: Path, lower: tuple[float, ...], upper: tuple[float, ...], scale: float = 1.0) -> Path:
    """A box between two corners as an OBJ file, in units of ``scale`` metres."""
    corners = [[(lower, upper)[bit][axis] / scale for axis, bit in enumerate(bits)] for bits in np.ndindex(2, 2, 2)]
    faces = [(1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {a} {b} {c} {d}" for a, b, c, d in faces]
    path.write_text("\n".join(lines) + "\n")
    return path
