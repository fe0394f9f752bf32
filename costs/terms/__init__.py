"""Terms of motion problems: the residuals of costs and constraints."""

from costs.terms.balance import CartTableZmpInPolygon, CentreOfMassAt, CentreOfMassInPolygon
from costs.terms.collision import Room, SweptClearance
from costs.terms.contact_place import ContactPlace
from costs.terms.displacement import FrameDisplacement
from costs.terms.equilibrium import ContactForce, Equilibrium, FrictionPyramid, MechanismBalance
from costs.terms.held_torque import HeldTorque
from costs.terms.joint import JointDifference, JointTarget
from costs.terms.joint_torque import JointTorque, StaticTorque
from costs.terms.on_guide import OnGuide
from costs.terms.pair_clearance import ClearancePerPair, PairClearance, RequiredClearance
from costs.terms.pose import AxisDirection, FramePose, PointHalfSpace
from costs.terms.region import BeyondBall, BeyondBox, LookAt
from costs.terms.rolling import RollingBase
from costs.terms.wrappers import (
    Between,
    Joined,
    Masked,
    NormWithin,
    PairWithin,
    Positive,
    Scaled,
    Widened,
    WithinTolerance,
)

__all__ = [
    "AxisDirection",
    "Between",
    "BeyondBall",
    "BeyondBox",
    "CartTableZmpInPolygon",
    "CentreOfMassAt",
    "CentreOfMassInPolygon",
    "ClearancePerPair",
    "ContactForce",
    "ContactPlace",
    "Equilibrium",
    "FrameDisplacement",
    "FramePose",
    "FrictionPyramid",
    "HeldTorque",
    "Joined",
    "JointDifference",
    "JointTarget",
    "JointTorque",
    "LookAt",
    "Masked",
    "MechanismBalance",
    "NormWithin",
    "OnGuide",
    "PairClearance",
    "PairWithin",
    "PointHalfSpace",
    "Positive",
    "RequiredClearance",
    "RollingBase",
    "Room",
    "Scaled",
    "StaticTorque",
    "SweptClearance",
    "Widened",
    "WithinTolerance",
]
