"""What a stranger does with a result folder: rebuild the robot from its URDF and look at the samples densely."""

import contextlib
import importlib
import io
import json
import sys
from pathlib import Path
from types import ModuleType

import coal
import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull

EXAMPLES = Path(__file__).parents[3] / "examples"


def load_checker() -> ModuleType:
    """Return the example that replays certificates."""
    sys.path.insert(0, str(EXAMPLES))
    try:
        return importlib.import_module("check_certificate")
    finally:
        sys.path.remove(str(EXAMPLES))


def check_folder(folder: Path) -> tuple[int, str]:
    """Replay a certificate by that example in this process; return its exit code and all that it says."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        try:
            code = int(load_checker().main(folder))
        except SystemExit as end:
            return 1, str(end.code)
    return code, printed.getvalue()


class Stranger:
    """A result folder read with nothing but pinocchio and coal."""

    def __init__(self, folder: Path) -> None:
        self.data = json.loads((folder / "result.json").read_text())
        robot = self.data["robot"]
        root = [pin.JointModelFreeFlyer()] if robot["root"] == "floating" else []
        self.model = pin.buildModelFromUrdf(str(folder / robot["urdf"]), *root)
        self.pin_data = self.model.createData()
        self.names = self.data["trajectory"]["joint_names"]
        self.positions = np.array(self.data["trajectory"]["positions"])
        self.times = np.array(self.data["trajectory"]["times"])

    def configuration(self, row: np.ndarray) -> np.ndarray:
        """pinocchio's q of one row of the trajectory."""
        values = dict(zip(self.names, row, strict=True))
        q = pin.neutral(self.model)
        if self.data["robot"]["root"] == "floating":
            q[:3] = [values[f"base_{k}"] for k in "xyz"]
            q[3:7] = [values[f"base_q{k}"] for k in "xyzw"]
        for joint in range(1, self.model.njoints):
            name = self.model.names[joint]
            if name in values:
                q[self.model.joints[joint].idx_q] = values[name]
        return q

    def placements(self, row: np.ndarray) -> dict[str, pin.SE3]:
        """World placement of every link."""
        pin.framesForwardKinematics(self.model, self.pin_data, self.configuration(row))
        return {frame.name: self.pin_data.oMf[i].copy() for i, frame in enumerate(self.model.frames)}

    def com(self, row: np.ndarray) -> np.ndarray:
        """Centre of mass of the robot as its URDF has it."""
        return pin.centerOfMass(self.model, self.pin_data, self.configuration(row)).copy()

    def rows(self, per_sample: int, stride: int = 1) -> np.ndarray:
        """Samples, and joint-linear reading between them."""
        p = self.positions[::stride]
        inner = [p[:-1] + (p[1:] - p[:-1]) * k / per_sample for k in range(per_sample)]
        return np.concatenate([np.stack(inner, axis=1).reshape(-1, p.shape[1]), p[-1:]])

    def closest(self, rows: np.ndarray, is_exempt) -> tuple[float, tuple[str, str]]:
        """Smallest distance of any body and any piece over the rows, pairs that may touch left out."""
        bodies = [(b["name"], b["link"], _convex(np.array(b["vertices"]))) for b in self.data["bodies"]]
        pieces = [(p["name"], _convex(np.array(p["vertices"]))) for p in self.data["pieces"]]
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        request.enable_signed_distance = True
        best = (np.inf, ("", ""))
        for row in rows:
            places = self.placements(row)
            for body, link, shape in bodies:
                pose = coal.Transform3s(places[link].rotation, places[link].translation)
                for piece, solid in pieces:
                    if is_exempt(body, link, piece):
                        continue
                    result.clear()
                    distance = coal.distance(shape, pose, solid, coal.Transform3s(), request, result)
                    best = min(best, (distance, (body, piece)))
        return best


def _convex(vertices: np.ndarray) -> coal.Convex:
    hull = ConvexHull(vertices)
    index = np.full(len(vertices), -1)
    index[hull.vertices] = np.arange(len(hull.vertices))
    points, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    points.extend(list(vertices[hull.vertices]))
    triangles.extend([coal.Triangle(int(a), int(b), int(c)) for a, b, c in index[hull.simplices]])
    return coal.Convex(points, triangles)
