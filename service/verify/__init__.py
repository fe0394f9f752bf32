"""The independent verifier: a motion goes in, a certificate comes out."""

from service.verify.certificate import Basis, Certificate, Check, Exempt, Status, Stretches, Where
from service.verify.errors import VerifyError
from service.verify.motion import (
    AxisTarget,
    CircleTarget,
    JointTarget,
    Motion,
    Phase,
    PlantedContact,
    PoseTarget,
    RelativePoseTarget,
    SupportPolygon,
    Target,
)
from service.verify.settings import VerifySettings
from service.verify.verifier import verify

__all__ = [
    "AxisTarget",
    "Basis",
    "Certificate",
    "Check",
    "CircleTarget",
    "Exempt",
    "JointTarget",
    "Motion",
    "Phase",
    "PlantedContact",
    "PoseTarget",
    "RelativePoseTarget",
    "Status",
    "Stretches",
    "SupportPolygon",
    "Target",
    "VerifyError",
    "VerifySettings",
    "Where",
    "verify",
]
