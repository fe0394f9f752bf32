"""The terms a motion is judged by, one file per idea."""

from costs.terms.balance import CartTableZmpInPolygon, CentreOfMassAt, CentreOfMassInPolygon
from costs.terms.collision import SweptClearance
from costs.terms.joint import JointDifference, JointTarget
from costs.terms.pose import AxisDirection, FramePose, PointHalfSpace
from costs.terms.tolerance import WithinTolerance

__all__ = [
    "AxisDirection",
    "CartTableZmpInPolygon",
    "CentreOfMassAt",
    "CentreOfMassInPolygon",
    "FramePose",
    "JointDifference",
    "JointTarget",
    "PointHalfSpace",
    "SweptClearance",
    "WithinTolerance",
]
