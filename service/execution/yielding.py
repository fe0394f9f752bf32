"""Arms in contact that yield: they keep the force on a surface within bounds, and look for a surface that is not there.

Contacts of both feet, arms and trunk close chains, in which errors of a few millimetres make forces of hundreds of
newtons on position servos.  An admittance along the contact's normal takes them away.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.robot import RobotModel
from costs.robot.servo import default_stiffness
from service.errors import ExecutionError
from service.execution.guards import press_on
from service.execution.offset import OffsetFilter
from service.verify import PlantedContact


@dataclass(frozen=True)
class YieldSettings:
    """How arms in contact yield.

    Attributes:
        most_share, limit_share: of a contact's cap, at which it yields: the first, or up to the second where the plan
            expects as much.
        expected_share: of the expected force, up to which it does not yield below the second of these.
        least_share: of the expected force, below which it presses harder.
        landing_n: force of a link that is about to be planted or let go, above which it yields [N].
        touch_n: force up to which a link looks for the surface that the next phase needs [N].
        time_s: in which a force comes back within its bounds [s].
        softness: of the rest of the robot at a contact, besides the arm's own [m/N].
        search_speed: at which a surface is looked for [m/s].
        most_speed: of the contact's displacement [m/s].
        most_m: largest displacement of the contact along its normal [m].
        fade_s: in which it goes back to the plan once it left the surface [s].
    """

    most_share: float = 0.7
    limit_share: float = 0.9
    expected_share: float = 1.2
    least_share: float = 0.5
    landing_n: float = 40.0
    touch_n: float = 10.0
    time_s: float = 0.3
    softness: float = 5e-5
    search_speed: float = 0.02
    most_speed: float = 0.05
    most_m: float = 0.03
    fade_s: float = 0.5

    def __post_init__(self) -> None:
        shares = (
            0.0 <= self.least_share <= 1.0 <= self.expected_share and 0.0 < self.most_share <= self.limit_share <= 1.0
        )
        sizes = (
            self.landing_n,
            self.touch_n,
            self.time_s,
            self.search_speed,
            self.most_speed,
            self.most_m,
            self.fade_s,
        )
        if not shares or not min(sizes) > 0.0 or self.touch_n > self.landing_n:
            raise ExecutionError(
                "yielding: expected shares around 1, and positive forces, times, speeds and distances; touch_n is at "
                "most landing_n"
            )

    @property
    def offset(self) -> OffsetFilter:
        """Limit of the displacements, and their way back."""
        return OffsetFilter(self.most_m, self.fade_s)


@dataclass(frozen=True)
class Arm:
    """Joints that carry a link and no other end of the robot.

    Attributes:
        link: that is planted.
        columns: of the joints in a configuration of the plan.
        joints: the same joints in the order of the commands.
    """

    link: str
    columns: np.ndarray
    joints: np.ndarray


@dataclass(frozen=True)
class ArmYield:
    """Displacement of an arm from its command.

    Attributes:
        offset: of its joints [rad, m].
        travel: of the contact along its normal, positive off the surface [m].
    """

    offset: np.ndarray
    travel: float = 0.0


@dataclass(frozen=True)
class ForceBounds:
    """Force along the normal of a contact within which it does not yield [N]."""

    contact: PlantedContact
    least: float
    most: float


def bound_forces(
    settings: YieldSettings,
    planted: Sequence[PlantedContact],
    landing: Sequence[PlantedContact],
    *,
    leaving: Collection[str] = (),
    is_waiting: bool,
    expected: Mapping[str, Float[np.ndarray, "6"]],
) -> dict[str, ForceBounds]:
    """Return the bounds by link.

    Args:
        settings: shares of caps and expected forces.
        planted: contacts of the present phase.
        landing: contacts that the next phase adds.
        leaving: links that the next phase lets go; they do not hold the robot any more.
        is_waiting: whether the plan's clock waits for these.
        expected: planned wrench (6,) per link, world axes [N, N m].
    """
    bounds = {}
    for contact in planted:
        wanted = press_on(contact, expected[contact.link][:3]) if contact.link in expected else 0.0
        cap = contact.force_cap_n * len(contact.sole)
        most = max(settings.most_share * cap, min(settings.expected_share * wanted, settings.limit_share * cap))
        least = settings.least_share * max(wanted, 0.0)
        if contact.link in leaving:
            least, most = 0.0, max(settings.expected_share * wanted, settings.landing_n)
        bounds[contact.link] = ForceBounds(contact, least, most)
    for contact in landing:
        bounds[contact.link] = ForceBounds(contact, settings.touch_n if is_waiting else 0.0, settings.landing_n)
    return bounds


def press_trunk(
    settings: YieldSettings,
    offset: Float[np.ndarray, "3"],
    bounds: Mapping[str, ForceBounds],
    measured: Mapping[str, Float[np.ndarray, "3"]],
    period_s: float,
) -> Float[np.ndarray, "3"]:
    """Return the displacement of the body one cycle later, which brings links of the trunk to what they press on.

    Args:
        settings: speeds and largest displacement.
        offset: (3,) the earlier displacement [m].
        bounds: of the trunk's links; the body goes back to the plan where there are none.
        measured: force (3,) per link, world axes [N].
        period_s: of the cycle [s].
    """
    held = settings.offset
    if not bounds:
        return held.fade(offset, period_s)
    for link, bound in bounds.items():
        if link not in measured or bound.contact.normal is None:
            continue
        force = press_on(bound.contact, measured[link])
        excess = force - float(np.clip(force, bound.least, bound.most))
        if excess:
            speed = _find_speed(settings, settings.softness, excess, force)
            offset = held.move(offset, speed * np.asarray(bound.contact.normal), period_s)
    return offset


def _find_speed(settings: YieldSettings, softness: float, excess: float, force: float) -> float:
    """Return the speed of a contact along its normal that brings its force back within its bounds in time [m/s]."""
    speed = softness * excess / settings.time_s
    if excess < 0.0 and force < 1.0:
        speed = min(speed, -settings.search_speed)
    return float(np.clip(speed, -settings.most_speed, settings.most_speed))


def find_branch(model: pin.Model, joint: int) -> list[int]:
    """Return the joints from one of them up to where another branch of the robot begins."""
    children = np.bincount(np.asarray(model.parents, dtype=int)[1:], minlength=model.njoints)
    branch = [joint]
    while (parent := int(model.parents[branch[-1]])) > 0 and children[parent] == 1:
        branch.append(parent)
    return branch


def holds_arm(model: pin.Model, hand: str, contacts: Iterable[PlantedContact]) -> bool:
    """Return whether a contact plants a link of the arm that carries a hand: hand, forearm or upper arm."""
    arm = set(find_branch(model, int(model.frames[model.getFrameId(hand)].parentJoint)))
    return any(int(model.frames[model.getFrameId(contact.link)].parentJoint) in arm for contact in contacts)


def find_arms(robot: RobotModel, joint_names: Sequence[str], contacts: Iterable[PlantedContact]) -> dict[str, Arm]:
    """Return the arms that contacts plant, by link; feet and the trunk are left out.

    Args:
        robot: of the plan.
        joint_names: order of the commands.
        contacts: of all phases of the plan.
    """
    model, feet, names = robot.model, robot.link_groups.get("feet", ()), list(joint_names)
    children = np.bincount(np.asarray(model.parents, dtype=int)[1:], minlength=model.njoints)
    arms = {}
    for link in dict.fromkeys(contact.link for contact in contacts if contact.normal is not None):
        joint = int(model.frames[model.getFrameId(link)].parentJoint)
        if link in feet or children[joint] > 1:
            continue
        columns = [int(model.joints[above].idx_v) for above in find_branch(model, joint)]
        columns = [column for column in columns if robot.joint_names[column] in names]
        if columns:
            order = [names.index(robot.joint_names[column]) for column in columns]
            arms[link] = Arm(link, np.array(columns), np.array(order))
    return arms


class Yielding:
    """Admittance of arms in contact, one displacement per planted link."""

    def __init__(
        self,
        robot: RobotModel,
        joint_names: Sequence[str],
        contacts: Iterable[PlantedContact],
        settings: YieldSettings | None = None,
    ) -> None:
        """Prepare the arms that a plan plants; arguments as of ``find_arms``."""
        self.settings, self.robot = settings or YieldSettings(), robot
        self.arms = find_arms(robot, joint_names, contacts)
        stiffness = default_stiffness(robot) if self.arms else {}
        self._soft = {
            link: np.array([1.0 / stiffness[robot.joint_names[column]] for column in arm.columns])
            for link, arm in self.arms.items()
        }
        self._data = robot.model.createData()

    def start(self) -> dict[str, ArmYield]:
        """Return arms that follow their commands."""
        return {link: ArmYield(np.zeros(len(arm.joints))) for link, arm in self.arms.items()}

    def step(
        self,
        earlier: Mapping[str, ArmYield],
        q: Float[np.ndarray, "n"],
        bounds: Mapping[str, ForceBounds],
        measured: Mapping[str, Float[np.ndarray, "3"]],
        period_s: float,
    ) -> dict[str, ArmYield]:
        """Return the displacements one cycle later.

        Args:
            earlier: those of the cycle before.
            q: (n,) configuration of the robot.
            bounds: of the links that touch or are about to; the others go back to the plan.
            measured: force (3,) per link, world axes [N].
            period_s: of the cycle [s].
        """
        settings, made, is_placed = self.settings, dict[str, ArmYield](), False
        for link, arm in self.arms.items():
            state = earlier[link]
            if link not in bounds or link not in measured:
                if not state.offset.any():
                    made[link] = state
                    continue
                left = settings.offset.fade(np.append(state.offset, state.travel), period_s)
                made[link] = ArmYield(left[:-1], float(left[-1]))
                continue
            contact, least, most = bounds[link].contact, bounds[link].least, bounds[link].most
            force = press_on(contact, measured[link])
            if least <= force <= most:
                made[link] = state
                continue
            if not is_placed:
                pin.computeJointJacobians(self.robot.model, self._data, q)
                is_placed = True
            made[link] = self._move(state, arm, contact, force - np.clip(force, least, most), force, period_s)
        return made

    def _move(
        self, state: ArmYield, arm: Arm, contact: PlantedContact, excess: float, force: float, period_s: float
    ) -> ArmYield:
        """Return an arm whose contact moves along its normal, off the surface if it presses too hard."""
        settings, model = self.settings, self.robot.model
        frame = model.getFrameId(arm.link)
        place = pin.updateFramePlacement(model, self._data, frame)
        jacobian = pin.getFrameJacobian(model, self._data, frame, pin.LOCAL_WORLD_ALIGNED)[:, arm.columns]
        point = place.rotation @ contact.sole.mean(axis=0)
        normal = np.asarray(contact.normal)
        row = normal @ (jacobian[:3] - pin.skew(point) @ jacobian[3:])
        direction = self._soft[arm.link] * row
        softness = float(row @ direction)  # displacement along the normal per force [m/N]
        if softness < 1e-9:
            return state
        speed = _find_speed(settings, max(softness, settings.softness), excess, force)
        travel = float(np.clip(state.travel + speed * period_s, -settings.most_m, settings.most_m))
        return ArmYield(state.offset + (travel - state.travel) / softness * direction, travel)
