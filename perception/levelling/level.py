"""Transform that makes a cloud level: z up, its floor at zero, x ahead of its sensor."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from perception.cleaning.clean import voxel_downsample
from perception.cloud import Cloud
from perception.levelling.look import find_look
from perception.levelling.surfaces import find_surfaces
from perception.levelling.upwards import LEAST_FLOOR, Upwards, find_floor_height, find_upwards

# A cloud that is tilted by no more than this stays as it is, and one that is lifted by no more needs no proposal.
_LEVEL_DEG, _LIFT = 2.5, 0.3
# Least log odds at which a direction is proposed, and below which a levelled cloud gets a doubt.
_SURE = 1.5
_USUAL_DEG = 60.0
_STEEPEST = np.cos(np.radians(60.0))
_FEWEST_POINTS = 200
# A cloud that spans more is in another unit, of which other notes speak [m].
_LARGEST_SPAN = 400.0


@dataclass(frozen=True)
class Levelling:
    """Proposed transform of a cloud.

    Attributes:
        pose: pose_level_cloud.
        tilt_deg: angle between upwards and the cloud's z.
        lift: height by which its floor moves [m].
        reason: what says where upwards is.
        is_sure: whether no other direction is about as likely.
        is_usual: whether upwards is an axis of a usual frame, tilted by less than 60 degrees.
    """

    pose: Float[np.ndarray, "4 4"]
    tilt_deg: float
    lift: float
    reason: str
    is_sure: bool
    is_usual: bool = True

    @property
    def text(self) -> str:
        """The pose as ``x y z qw qx qy qz``, as options and requests take it."""
        turn = Rotation.from_matrix(self.pose[:3, :3]).as_quat(canonical=True, scalar_first=True)
        lengths = np.round(self.pose[:3, 3], 3) + 0.0
        return " ".join([*(f"{value:g}" for value in lengths), *(f"{value:.5f}" for value in np.round(turn, 5) + 0.0)])


def find_levelling(cloud: Cloud, known_up: Float[np.ndarray, "3"] | None = None) -> Levelling | None:
    """Return the transform that makes a cloud level; None if nothing says where upwards is.

    Args:
        known_up: (3,) upwards in the frame of the cloud, as an accelerometer or a transform of the file says.
    """
    span = np.ptp(np.percentile(cloud.points, [1, 99], axis=0), axis=0).max()
    if len(cloud.points) < _FEWEST_POINTS or span > _LARGEST_SPAN:
        return None
    if known_up is None:
        upwards = find_upwards(cloud)
        if upwards is None:
            return None
        up, reason, is_sure = upwards.direction, _explain(upwards), upwards.margin >= _SURE
        is_usual = upwards.evidence.usual_deg < _USUAL_DEG
    else:
        up, reason, is_sure = known_up / np.linalg.norm(known_up), "as the file says", True
        is_usual = True
    rotation = _turn_upright(up, find_look(cloud).ahead)
    pivot = np.median(np.atleast_2d(cloud.origin), axis=0)
    floor = find_floor_height(find_surfaces(cloud.points, cloud.starts), up)
    if floor is None:
        floor = float(np.percentile(voxel_downsample(cloud.points, 0.05)[0] @ up, 1.0))
        reason = f"{reason}; no floor is in view, and its lowest points are taken to lie on one"
    shift = pivot - rotation @ pivot
    shift[2] = -floor
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, shift
    tilt = float(np.degrees(np.arccos(np.clip(up[2], -1.0, 1.0))))
    return Levelling(pose, tilt, -floor, reason, is_sure, is_usual)


def make_level(cloud: Cloud, known_up: Float[np.ndarray, "3"] | None = None) -> Cloud:
    """Return the cloud made level, with a note that says how; as it is with a note if nothing says where upwards is."""
    levelling = find_levelling(cloud, known_up)
    if levelling is None:
        return replace(cloud, notes=(*cloud.notes, "not levelled: no flat surface says where upwards is"))
    note = (
        f"levelled: turned by {levelling.tilt_deg:.1f} deg and lifted by {levelling.lift:.2f} m, "
        f"{levelling.reason}; the transform {levelling.text} does the same"
    )
    if not levelling.is_sure:
        note = f"{note}; another direction is about as likely, look at it before you use it"
    return replace(move_cloud(cloud, levelling.pose), notes=(*cloud.notes, note))


def propose_level(cloud: Cloud, known_up: Float[np.ndarray, "3"] | None = None) -> tuple[str, ...]:
    """Return a note with the transform of a cloud that is clearly not level; empty for others."""
    levelling = find_levelling(cloud, known_up)
    if levelling is None or (levelling.is_usual and not levelling.is_sure):
        return ()
    at_zero = not np.atleast_2d(cloud.origin).any()
    if not levelling.is_usual:
        what = "looks upside down or laid on its side, unless its rays start elsewhere than stated"
    elif levelling.tilt_deg > _LEVEL_DEG:
        what = f"is tilted by {levelling.tilt_deg:.1f} deg"
    elif at_zero and levelling.lift > _LIFT:
        what = f"looks sensor-framed: its floor is {levelling.lift:.2f} m below zero"
    else:
        return ()
    return (
        f"{what} ({levelling.reason}): ask for levelling, or give the transform {levelling.text} "
        "to a world with z up and its floor at 0",
    )


def move_cloud(cloud: Cloud, pose: Float[np.ndarray, "4 4"]) -> Cloud:
    """Return the cloud in another frame."""

    def move(places: Float[np.ndarray, "*N 3"]) -> Float[np.ndarray, "*N 3"]:
        return np.asarray(places @ pose[:3, :3].T + pose[:3, 3])

    return replace(
        cloud,
        points=move(cloud.points),
        origin=move(cloud.origin),
        misses=move(cloud.misses),
        miss_origin=None if cloud.miss_origin is None else move(cloud.miss_origin),
    )


def _turn_upright(up: Float[np.ndarray, "3"], ahead: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Return the rotation that turns ``up`` to z.

    A frame whose z points up more or less is turned no further; of others, the sensor's direction becomes x, or the
    first axis that is level enough.
    """
    if up[2] > _STEEPEST:
        axis = np.cross(up, [0.0, 0.0, 1.0])
        sine = float(np.linalg.norm(axis))
        turn = np.arctan2(sine, up[2]) * axis / max(sine, 1e-12)
        return np.asarray(Rotation.from_rotvec(turn).as_matrix())
    level = next(axis for axis in (ahead, *np.eye(3)) if np.linalg.norm(np.cross(axis, up)) > 0.3)
    x = level - (level @ up) * up
    x /= np.linalg.norm(x)
    return np.array([x, np.cross(up, x), up])


def _explain(upwards: Upwards) -> str:
    evidence = upwards.evidence
    if evidence.floor + evidence.ceiling > LEAST_FLOOR:
        return "upwards from the largest level surface"
    if evidence.n_walls > 1:
        return "upwards from walls"
    return "upwards from one wall and a camera that is held square"
