"""An earlier motion as the beginning of a search: which part of it is of use from a new start."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from costs.robot import turn_near
from service.body.paths import cut_path
from service.errors import RequestError
from service.setup.prepare import PlanSetup

MOST_OFF = 0.5  # of a start from the nearest waypoint of an earlier motion [rad, m]


def begin_with(setup: PlanSetup, path: Float[np.ndarray, "T n"]) -> PlanSetup:
    """Return the setup with what is left of a path from its start on, or with a note why that is no help.

    Raises:
        RequestError: the path's width is not the number of the robot's coordinates.
    """
    n = setup.robot.n
    if path.ndim != 2 or path.shape[1] != n or not np.all(np.isfinite(path)):
        raise RequestError(
            f"start_from: has shape {path.shape}; expected finite numbers (T, {n}) of {setup.robot.name}"
        )
    if not len(path):
        return _note(setup, "the earlier result has no motion")
    path = path + (turn_near(setup.robot, path[0], setup.start) - path[0])
    off = np.abs(path - setup.start)
    nearest = int(off.max(axis=1).argmin())
    if off[nearest].max() > MOST_OFF:
        joint = setup.robot.joint_names[int(off[nearest].argmax())]
        words = f"the start is {off[nearest].max():.2f} off at {joint} from every waypoint of the earlier motion"
        return _note(setup, words)
    rest = cut_path(path, setup.start)
    return _note(setup, "the start is at the end of the earlier motion") if rest is None else replace(setup, known=rest)


def _note(setup: PlanSetup, why: str) -> PlanSetup:
    return replace(setup, notes=(*setup.notes, f"start_from: {why}; the motion is searched anew"))
