"""TrajOpt's problem files: read, held to a robot, and made terms of the optimiser (docs/trajopt.md)."""

from service.trajopt.program import Program, Timeline
from service.trajopt.reader import Reading, read_problem
from service.trajopt.requested import requested_program, requested_start
from service.trajopt.targets import Promises
from service.trajopt.terms import Builder

__all__ = [
    "Builder",
    "Program",
    "Promises",
    "Reading",
    "Timeline",
    "read_problem",
    "requested_program",
    "requested_start",
]
