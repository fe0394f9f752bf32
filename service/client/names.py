"""What a user calls the clouds whose ids a server speaks of."""

from __future__ import annotations

import re
from collections import OrderedDict
from pathlib import Path

import grpc

from service.client.errors import FieldViolation, PlannerError

MOST = 1000
_ID = re.compile(r"'?(sha256:[0-9a-f]{12,64}(?:\.\w+)?)…?'?")  # also one that was quoted, and cut short
_PATH = re.compile(r"got '(/[^']+)'")
_REFUSED = (grpc.StatusCode.INVALID_ARGUMENT, grpc.StatusCode.RESOURCE_EXHAUSTED, grpc.StatusCode.NOT_FOUND)
_OF_UPLOADS = re.compile(r"^(?:chunk: |header\.(?=\w+: ))")


class CloudNames:
    """The files that uploaded clouds were read from; the last thousand."""

    def __init__(self) -> None:
        self._files: OrderedDict[str, str] = OrderedDict()

    def remember(self, cloud_id: str, path: Path) -> None:
        """A cloud that the server has now."""
        self._files[cloud_id] = str(path)
        while len(self._files) > MOST:
            self._files.popitem(last=False)

    def in_words_of_here(self, error: PlannerError) -> PlannerError:
        """The error with files in place of ids; of a path that is no file here either, it says so."""
        if error.code not in _REFUSED:
            return error
        violations = tuple(FieldViolation(one.field, self._said(one.description)) for one in error.violations)
        return PlannerError(error.code, self._said(error.text), violations, error.retry_delay_s)

    def _said(self, text: str) -> str:
        said = _ID.sub(lambda match: self._file(match[1]) or match[0], text)
        path = _PATH.search(said)
        if path is not None and "cloud_id" in said and not Path(path[1]).is_file():
            said += "; it is no file here that could be uploaded"
        return said

    def _file(self, beginning: str) -> str | None:
        files = {file for cloud_id, file in tuple(self._files.items()) if cloud_id.startswith(beginning)}
        return files.pop() if len(files) == 1 else None


def of_upload(error: PlannerError, path: Path) -> PlannerError:
    """The error of an upload, with the file that was refused."""
    if error.code not in _REFUSED:
        return error
    violations = tuple(FieldViolation(one.field, _of(path, one.description)) for one in error.violations)
    return PlannerError(error.code, _of(path, error.text), violations, error.retry_delay_s)


def _of(path: Path, text: str) -> str:
    return f"{path}: {_OF_UPLOADS.sub('', text)}"
