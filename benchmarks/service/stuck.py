"""A job that cannot be stopped from within."""

from __future__ import annotations

import ctypes

from service.executor import Control


def stuck_in_native_code(control: Control) -> None:
    """Hold the interpreter's lock in a call that never returns."""
    control.report("stuck")
    ctypes.PyDLL(None).sleep(600)


def tell(control: Control) -> None:
    """Report that the job has started."""
    control.report("begun")
