"""Work that nobody waits for, such as log lines: done a moment after an answer, so that it delays no other one."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from contextvars import copy_context
from functools import partial
from typing import Any

LATER_S = 0.01


class Later:
    """Calls of functions on the event loop, ``LATER_S`` later and in order, each in the context of now."""

    def __init__(self) -> None:
        self._waiting: deque[Callable[[], object]] = deque()

    def call(self, fn: Callable[..., object], *args: Any) -> None:
        """Call a function later, or at ``finish``."""
        self._waiting.append(partial(copy_context().run, fn, *args))
        asyncio.get_running_loop().call_later(LATER_S, self._call_next)

    def finish(self) -> None:
        """Make all calls now."""
        while self._waiting:
            self._call_next()

    def _call_next(self) -> None:
        if self._waiting:
            self._waiting.popleft()()
