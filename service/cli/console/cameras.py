"""Pictures of cameras beside the view: any HTTP source that the console was given, fetched by the console itself."""

from __future__ import annotations

import asyncio
import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from urllib.error import HTTPError, URLError
from urllib.parse import urlsplit
from urllib.request import Request, urlopen

from service.errors import RequestError, ServiceError, shown, would_do

KINDS = ("image/png", "image/jpeg", "image/webp")
MOST_BYTES = 4 * 2**20
WAIT_S = 3.0
MARKS = "X-Marks"  # header with the pixels of what the plan leads, as shares of width and height
MOST_MARKS = 20


@dataclass(frozen=True)
class CameraSource:
    """A source of pictures.

    Attributes:
        name: of the camera.
        url: where each request gets the newest picture.
        phases: words of the names of phases in which it is shown; empty: in all that no other camera names.
    """

    name: str
    url: str
    phases: tuple[str, ...] = ()


def parse_camera(text: str) -> CameraSource:
    """Return the camera of a text ``NAME=URL`` or ``NAME@WORD+WORD=URL``.

    Raises:
        RequestError: it is none.
    """
    named, equals, url = text.partition("=")
    name, at, words = named.partition("@")
    phases = tuple(filter(None, words.split("+")))
    address = urlsplit(url)
    is_web = address.scheme in ("http", "https") and bool(address.hostname)
    if not (equals and name.strip() and is_web) or (at and not phases):
        raise RequestError(
            f"--camera {shown(text)}: expected NAME=URL or NAME@WORD+WORD=URL with words of phases, such as "
            "feet@step+walk=http://127.0.0.1:8090/feet.png"
        )
    return CameraSource(name.strip(), url, phases)


async def take_picture(cameras: Sequence[CameraSource], name: str) -> dict[str, Any]:
    """Return the newest picture of a camera as a data URL, with its marks.

    Raises:
        RequestError: there is no such camera.
        ServiceError: it gives no picture now.
    """
    known = {camera.name: camera for camera in cameras}
    if name not in known:
        raise RequestError(f"camera: there is no camera {shown(name)}; expected {would_do(name, known) or '--camera'}")
    return await asyncio.to_thread(_fetch, known[name])


def _fetch(camera: CameraSource) -> dict[str, Any]:
    try:
        with urlopen(Request(camera.url), timeout=WAIT_S) as answer:  # http or https, of the command line
            kind = answer.headers.get_content_type()
            data = answer.read(MOST_BYTES + 1)
            marks = read_marks(answer.headers.get(MARKS, ""))
    except HTTPError as error:
        error.close()
        raise ServiceError(f"camera {camera.name} gives no picture: {error.code} {error.reason}") from None
    except (URLError, OSError, ValueError) as error:
        reason = getattr(error, "reason", "") or str(error) or "no answer"
        raise ServiceError(f"camera {camera.name} gives no picture: {reason}") from None
    if kind not in KINDS or len(data) > MOST_BYTES:
        raise ServiceError(
            f"camera {camera.name} gives {shown(kind)} of {len(data)} bytes; expected {', '.join(KINDS)} up to 4 MiB"
        )
    return {"image": f"data:{kind};base64,{base64.b64encode(data).decode()}", "marks": marks}


def read_marks(text: str) -> dict[str, list[float]]:
    """Return the marks of a picture's header; what is no mark is left out."""
    try:
        given = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    if not isinstance(given, Mapping):
        return {}
    marks = {}
    for name, at in list(given.items())[:MOST_MARKS]:
        is_pair = isinstance(at, list) and len(at) == 2 and all(isinstance(x, int | float) for x in at)
        if is_pair and all(0.0 <= x <= 1.0 for x in at):
            marks[name[:60]] = [float(x) for x in at]
    return marks
