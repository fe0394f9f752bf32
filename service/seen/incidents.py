"""What should not have happened: the log gets all of it, the client a number by which it is found there."""

from __future__ import annotations

import secrets
from typing import Any

import grpc
import structlog

from service.rpc import Refusal

_LOG = structlog.get_logger("scopt.server")


def incident(error: BaseException, **where: Any) -> Refusal:
    """Log an error that nobody expected; how the call ends that it has ended.

    Args:
        error: with its traceback.
        where: that the log is to have besides.
    """
    number = secrets.token_hex(4)
    _LOG.error("incident", incident=number, exc_info=error, **where)
    return Refusal(grpc.StatusCode.INTERNAL, f"internal error {number}, please report it; the server's log tells more")
