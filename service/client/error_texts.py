"""Errors in the user's terms: local file names, the last step before a deadline, reasons of failed connections."""

from __future__ import annotations

import re
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path

import grpc

from service.client.connection import Connection
from service.client.errors import FieldViolation, PlannerError
from service.proto.planner.v1.planner_pb2 import BuildSceneResponse, PlanResponse

MAX_NAMES = 1000
_ID = re.compile(r"'?(sha256:[0-9a-f]{12,64}(?:\.\w+)?)…?'?")  # also quoted, and cut short
_PATH = re.compile(r"got '(/[^']+)'")
_REFUSED = (
    grpc.StatusCode.INVALID_ARGUMENT,
    grpc.StatusCode.RESOURCE_EXHAUSTED,
    grpc.StatusCode.NOT_FOUND,
    grpc.StatusCode.DATA_LOSS,
)
_UPLOAD_FIELD = re.compile(r"^(?:chunk: |header\.(?=\w+: ))")
# Texts of gRPC and of a server for a passed deadline; a server that refuses a near deadline at once says more.
_DEADLINE_PASSED = ("Deadline Exceeded", "the deadline passed")
# First words of gRPC's own texts: the connection was never made, or it broke.
_NEVER_CONNECTED = ("failed to connect to all addresses", "errors resolving", "DNS resolution failed")
_BROKEN = (
    "Socket closed",
    "recvmsg:",
    "sendmsg:",
    "Stream removed",
    "Connection reset",
    "Broken pipe",
    "keepalive watchdog",
)
_CLOSED_BY_SERVER = ("Socket closed", "Connection reset", "Broken pipe", "Stream removed")
_SILENT = "timed out before receiving SETTINGS frame"  # a port that is bound before the server answers
_NO_GRPC = ("Failed parsing HTTP/2", "http1.x", "SETTINGS frame", "Handshake read failed")


class UploadNames:
    """Local files behind the ids of uploads; keeps the last ``MAX_NAMES``."""

    def __init__(self) -> None:
        self._files: OrderedDict[str, str] = OrderedDict()

    def add(self, upload_id: str, path: Path) -> None:
        """Remember the file of an upload."""
        self._files[upload_id] = str(path)
        while len(self._files) > MAX_NAMES:
            self._files.popitem(last=False)

    def restore(self, error: PlannerError) -> PlannerError:
        """Return the error with file names in place of ids."""
        return _change_texts(error, self._restore_text)

    def _restore_text(self, text: str) -> str:
        restored = _ID.sub(lambda match: self._file(match[1]) or match[0], text)
        path = _PATH.search(restored)
        if path is not None and "cloud_id" in restored and not Path(path[1]).is_file():
            restored += "; no such file on this machine either, so it was not uploaded"
        return restored

    def _file(self, id_start: str) -> str | None:
        files = {file for upload_id, file in tuple(self._files.items()) if upload_id.startswith(id_start)}
        return files.pop() if len(files) == 1 else None


def name_uploaded_file(error: PlannerError, path: Path) -> PlannerError:
    """Return the error of a refused upload with the file's path in place of the message's field."""
    return _change_texts(error, lambda text: f"{path}: {_UPLOAD_FIELD.sub('', text)}")


class LastStep:
    """Last step that the events of a stream report."""

    def __init__(self) -> None:
        self._words = ""

    def take(self, event: object) -> None:
        """Read the next event."""
        if isinstance(event, BuildSceneResponse) and event.step:
            self._words = f"; last step: {event.step!r}"
        elif isinstance(event, PlanResponse) and event.HasField("queued"):
            self._words = "; it was still in the queue"
        elif isinstance(event, PlanResponse) and event.HasField("progress"):
            self._words = f"; last step: {event.progress.step!r}"

    def explain_deadline(self, error: PlannerError, deadline_s: float | None) -> PlannerError:
        """Return the error; if the deadline passed, with its length and the last step."""
        is_late = error.code is grpc.StatusCode.DEADLINE_EXCEEDED and any(
            words in error.text for words in _DEADLINE_PASSED
        )
        if not is_late or deadline_s is None:
            return error
        return PlannerError(error.code, f"no answer within {deadline_s:.3g} s{self._words}")


def explain_unreachable(error: PlannerError, connection: Connection) -> PlannerError:
    """Return the error; gRPC's own text of a failed connection becomes its likely reason, other texts stay."""
    if error.code is not grpc.StatusCode.UNAVAILABLE:
        return error
    return PlannerError(error.code, _explain(error.text, connection), error.violations, error.retry_delay_s)


def _change_texts(error: PlannerError, change: Callable[[str], str]) -> PlannerError:
    if error.code not in _REFUSED:
        return error
    violations = tuple(FieldViolation(wrong.field, change(wrong.description)) for wrong in error.violations)
    return PlannerError(error.code, change(error.text), violations, error.retry_delay_s)


def _explain(text: str, connection: Connection) -> str:
    target = connection.target
    if text.startswith(_BROKEN):
        return f"the connection to {target} broke"
    if not text.startswith(_NEVER_CONNECTED):
        return text
    if "resolv" in text.lower():
        return f"target: no address is known for {target}; check the name"
    if "CERTIFICATE_VERIFY_FAILED" in text:
        known = "the authority in tls_ca (--tls-ca)" if connection.tls_ca is not None else "any authority known here"
        return f"the server's certificate at {target} does not come from {known}; give its authority as tls_ca"
    if "Hostname Verification" in text:
        return f"the server's certificate is not for {target}; use a host name that the certificate contains"
    if "WRONG_VERSION_NUMBER" in text:
        return f"the server at {target} does not use TLS; leave out tls_ca (--tls-ca), or check the port"
    if _SILENT in text:
        return f"the server at {target} does not answer yet; it is starting, or is no planning service: try again"
    if any(words in text for words in _NO_GRPC):
        return f"the program at {target} is no planning service; check the port"
    if any(words in text for words in _CLOSED_BY_SERVER):
        return f"the server at {target} closes the connection; {_suggest_tls(connection)}"
    return f"no server answers at {target}; start one there with `scopt serve`, or try again if it is still starting"


def _suggest_tls(connection: Connection) -> str:
    if not connection.is_secure:
        return "it may use TLS: give tls_ca (--tls-ca)"
    if connection.tls_cert is None:
        return "it may require a client certificate: give tls_cert and tls_key (--tls-cert, --tls-key)"
    return "it may not know the authority that tls_cert (--tls-cert) comes from"
