"""The task of a problem file: plain data that ``service.trajopt`` reads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from service.request.tasks.kind import TaskSection


@dataclass(frozen=True)
class ProblemSection(TaskSection):
    """A problem as in TrajOpt's files (docs/trajopt.md).

    Attributes:
        document: its content.
    """

    document: Mapping[str, Any]

    @property
    def can_resume(self) -> bool:
        """No: a problem has no phases."""
        return False

    @property
    def takes_trajectories(self) -> bool:
        """Yes: a problem is one phase."""
        return True
