"""The independent verifier: a motion goes in, a certificate comes out.

Read in this order:

- ``motion``: the input, a motion with what its phases promise; ``validation`` rejects a malformed one
- ``verifier``: the sequence of checks, and how to add one
- ``limits``, ``stance_checks``, ``ground``, ``mechanism_checks``: the checks
- ``targets``: errors of poses, and the checks of targets
- ``forces``: equilibrium under the loads of hands, and inverse dynamics
- ``clearance``: the checks of all pairs that may meet
- ``coverage``: what was checked, what was left out, and which checks a motion requires
- ``certificate``: the output as data; ``hashes`` ties it to its robot, scene and promises
- ``prepared_motion``, ``curve_bounds``, ``joint_chain``, ``frame_paths``, ``phase_proof``, ``solids``, ``timeline``:
  shared by the proofs; ``rounding``: numbers in the texts of checks
"""

from service.verify.certificate import Basis, Certificate, Check, Exempt, Status, Stretches, Where
from service.verify.motion import (
    AxisTarget,
    CircleTarget,
    HandContact,
    HandLoad,
    HandPush,
    HeldJoint,
    JointTarget,
    LoadedRegion,
    Motion,
    Phase,
    PlantedContact,
    PoseTarget,
    PressedPart,
    RelativePoseTarget,
    SupportPolygon,
    Target,
    VerifyError,
    VerifySettings,
)
from service.verify.verifier import verify

__all__ = [
    "AxisTarget",
    "Basis",
    "Certificate",
    "Check",
    "CircleTarget",
    "Exempt",
    "HandContact",
    "HandLoad",
    "HandPush",
    "HeldJoint",
    "JointTarget",
    "LoadedRegion",
    "Motion",
    "Phase",
    "PlantedContact",
    "PoseTarget",
    "PressedPart",
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
