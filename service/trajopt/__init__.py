"""TrajOpt's problem files: read, resolved for a robot, and made terms of the optimiser (docs/trajopt.md)."""

from service.trajopt.program import Program, Timeline
from service.trajopt.request import make_program
from service.trajopt.terms import Builder
from service.trajopt.verifier_targets import Promises

__all__ = ["Builder", "Program", "Promises", "Timeline", "make_program"]
