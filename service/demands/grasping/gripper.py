"""Grippers of a robot: two fingers that slide along a straight line, measured on their shapes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.robot import RobotModel, read_joint_axis
from service.demands.hands import Hand, list_robot_hands

PAD_DEPTH_M = 2e-3  # from a finger's foremost points within which its surface counts as the pad
PARALLEL = 0.999  # least cosine between the ways of both fingers


@dataclass(frozen=True)
class Gripper:
    """A hand with two fingers; distances are in its tool frame, whose z axis points along the hand.

    Attributes:
        side: ``left`` or ``right``.
        tool: frame.
        link: the hand itself.
        front: link that carries the fingers, which may be the hand.
        fingers: links; the first one is on the side of ``closing``.
        joints: coordinates that move the fingers, by finger; the same one twice where one follows the other.
        closing: (3,) unit, in the tool frame: the way on which the first finger opens.
        faces: position of each pad along ``closing`` with its joint at 0 [m].
        least, most: limits of the joints [m].
        force_n: largest force of a finger.
        tip, palm: positions of the fingers' ends and of the hand's front along z [m].
        pads: ends of the pads along z [m].
        flank_m: of the fingers' sides from the middle, across ``closing`` [m].
    """

    side: str
    tool: str
    link: str
    front: str
    fingers: tuple[str, str]
    joints: tuple[str, str]
    closing: Float[np.ndarray, "3"]
    faces: tuple[float, float]
    least: tuple[float, float]
    most: tuple[float, float]
    force_n: float
    tip: float
    palm: float
    pads: tuple[float, float]
    flank_m: float

    @property
    def widest(self) -> float:
        """Largest distance between the pads [m]."""
        return self.faces[0] + self.most[0] - (self.faces[1] - self.most[1])

    @property
    def follows(self) -> bool:
        """Whether one coordinate moves both fingers."""
        return self.joints[0] == self.joints[1]

    def find_values(self, first: float, second: float) -> dict[str, float] | str:
        """Return the joints with the pads at two positions along ``closing``, or a sentence why they cannot be there.

        Args:
            first, second: positions of the pads of the first and the second finger [m].
        """
        values = np.array([first - self.faces[0], self.faces[1] - second])
        if self.follows:
            values[:] = values.mean()
        low, high = np.array(self.least), np.array(self.most)
        width = first - second
        if np.any(values > high + 1e-9):
            return f"{1e3 * width:.0f} mm wide; the {self.side} gripper opens to {1e3 * self.widest:.0f} mm"
        if np.any(values < low - 1e-9):
            least = self.faces[0] + low[0] - (self.faces[1] - low[1])
            return f"{1e3 * width:.0f} mm thin; the {self.side} gripper closes to {1e3 * least:.0f} mm"
        return dict(zip(self.joints, values.tolist(), strict=True))


def list_grippers(robot: RobotModel, side: str) -> tuple[Gripper, ...]:
    """Return the grippers of a side (``auto`` and ``both``: of both) that a robot has."""
    hands = [hand for hand in list_robot_hands(robot) if side in ("auto", "both", hand.side)]
    made = [_measure_gripper(robot, hand) for hand in hands]
    return tuple(gripper for gripper in made if gripper is not None)


def _measure_gripper(robot: RobotModel, hand: Hand) -> Gripper | None:
    """Return a hand's gripper; None where it has no two fingers that slide along one line."""
    model = robot.model
    if not all(model.existFrame(name) for name in (hand.tool, hand.link, *hand.fingers)):
        return None
    data = model.createData()
    q = np.zeros(model.nq)
    pin.framesForwardKinematics(model, data, q)
    tool = data.oMf[model.getFrameId(hand.tool)]
    ways, joints, least, most, force = [], [], [], [], []
    for finger in hand.fingers:
        joint = int(model.frames[model.getFrameId(finger)].parentJoint)
        made = model.joints[joint]
        axis = read_joint_axis(robot, joint) if joint > 0 else np.zeros(6)
        if not np.any(axis[:3]) or np.any(axis[3:]):
            return None
        column = int(made.idx_q)
        if made.shortname() == "JointModelMimic":
            axis = axis / float(made.extract().scaling)
        ways.append(tool.rotation.T @ data.oMi[joint].rotation @ axis[:3])
        joints.append(robot.joint_names[column])
        least.append(float(robot.lower[column]))
        most.append(float(robot.upper[column]))
        effort = float(robot.effort[column])
        force.append(effort if np.isfinite(effort) and effort > 0.0 else np.inf)
    closing = ways[0] / np.linalg.norm(ways[0])
    if ways[1] @ closing > -PARALLEL:
        return None
    points = [_list_points(robot, data, tool, finger) for finger in hand.fingers]
    palms = [
        _list_points(robot, data, tool, name)
        for name in dict.fromkeys((hand.link, hand.palm))
        if model.existFrame(name)
    ]
    if not all(map(len, points)) or not any(map(len, palms)):
        return None
    faces = float((points[0] @ closing).min()), float((points[1] @ closing).max())
    pads = [
        part[sense * (part @ closing) <= sense * face + PAD_DEPTH_M]
        for part, face, sense in zip(points, faces, (1.0, -1.0), strict=True)
    ]
    low, high = max(pad[:, 2].min() for pad in pads), min(pad[:, 2].max() for pad in pads)
    front = max(float(part[:, 2].max()) for part in palms if len(part))
    flank = np.cross([0.0, 0.0, 1.0], closing)
    return Gripper(
        side=hand.side,
        tool=hand.tool,
        link=hand.link,
        front=hand.palm if model.existFrame(hand.palm) else hand.link,
        fingers=hand.fingers,
        joints=(joints[0], joints[1]),
        closing=closing,
        faces=faces,
        least=(least[0], least[1]),
        most=(most[0], most[1]),
        force_n=min(force),
        tip=float(max(part[:, 2].max() for part in points)),
        palm=front,
        pads=(float(low), float(high)),
        flank_m=min(float(np.abs(part @ flank).max()) for part in points),
    )


def _list_points(robot: RobotModel, data: pin.Data, tool: pin.SE3, link: str) -> Float[np.ndarray, "N 3"]:
    """Return the corners of a link's bodies in the tool frame [m]."""
    parts = [np.zeros((0, 3))]
    for body in robot.bodies:
        if body.link == link:
            place = tool.actInv(data.oMi[body.joint])
            parts.append(body.vertices @ place.rotation.T + place.translation)
    return np.concatenate(parts)
