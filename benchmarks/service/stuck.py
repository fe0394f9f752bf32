"""What a worker runs that cannot be stopped from within."""

from __future__ import annotations

import ctypes

from service.executor import Control


def stuck_in_native_code(control: Control) -> None:
    """Hold the interpreter's lock in a call that does not come back."""
    control.report("stuck")
    ctypes.PyDLL(None).sleep(600)


def tell(control: Control) -> None:
    """Say that it is one's turn."""
    control.report("begun")
