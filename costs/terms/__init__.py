"""Terms of motion problems: the residuals of costs and constraints."""

from costs.terms.balance import CartTableZmpInPolygon, CentreOfMassAt, CentreOfMassInPolygon
from costs.terms.collision import SweptClearance
from costs.terms.displacement import FrameDisplacement
from costs.terms.joint import JointDifference, JointTarget
from costs.terms.pair_clearance import ClearancePerPair, PairClearance, RequiredClearance
from costs.terms.pose import AxisDirection, FramePose, PointHalfSpace
from costs.terms.wrappers import Between, Masked, NormWithin, Scaled, WithinTolerance

__all__ = [
    "AxisDirection",
    "Between",
    "CartTableZmpInPolygon",
    "CentreOfMassAt",
    "CentreOfMassInPolygon",
    "ClearancePerPair",
    "FrameDisplacement",
    "FramePose",
    "JointDifference",
    "JointTarget",
    "Masked",
    "NormWithin",
    "PairClearance",
    "PointHalfSpace",
    "RequiredClearance",
    "Scaled",
    "SweptClearance",
    "WithinTolerance",
]
