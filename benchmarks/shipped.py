"""The bundled example requests."""

from __future__ import annotations

from pathlib import Path

from service.errors import UnplannedTaskError
from service.request.file import load_request
from service.request.schema import check_task_has_planner

FOLDER = Path(__file__).resolve().parents[1] / "examples" / "requests"


def shipped_requests() -> list[Path]:
    """Return the requests whose tasks can be planned."""
    return [path for path in sorted(FOLDER.glob("*.yaml")) if _is_planned(path)]


def _is_planned(path: Path) -> bool:
    try:
        check_task_has_planner(load_request(path))
    except UnplannedTaskError:
        return False
    return True
