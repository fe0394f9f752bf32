"""``manifest.json``: hashes of the files of a result folder, beside which no other statement says what they hold."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import orjson

from service.errors import ResultError, shown
from service.result.folder import APPROVAL_NAME, MANIFEST_NAME, RESULT_NAME, REVOCATION_NAME, TRAJECTORY_NAME
from service.viewer.files import replace_file

FORMAT = "scopt-manifest/1"
# Their content is compared with the certificate, or signed; a hash of their bytes would refuse harmless white space.
UNLISTED = frozenset({RESULT_NAME, TRAJECTORY_NAME, MANIFEST_NAME, APPROVAL_NAME, REVOCATION_NAME})
MAX_MANIFEST_BYTES = 4 * 2**20
MAX_LISTED = 10_000  # files of a folder; a result has some hundred meshes


@dataclass(frozen=True)
class Manifest:
    """Hashes of a folder's files.

    Attributes:
        certificate_sha256: of the certificate that the files belong to (``hash_certificate``).
        files: sha256 by path in the folder.
    """

    certificate_sha256: str
    files: Mapping[str, str]


def hash_certificate(data: Mapping[str, Any]) -> str:
    """Return ``sha256:`` of the compact JSON of a result's certificate, as servers send it; empty without one."""
    certificate = data.get("certificate")
    return "" if certificate is None else "sha256:" + hashlib.sha256(orjson.dumps(certificate)).hexdigest()


def hash_file(path: Path) -> str:
    """Return ``sha256:`` of a file's bytes (OSError where it cannot be read)."""
    with path.open("rb") as file:
        return "sha256:" + hashlib.file_digest(file, "sha256").hexdigest()


def list_files(folder: Path) -> dict[str, Path]:
    """Return the paths of everything in a folder that is no folder, by name; links are listed and not followed.

    Raises:
        ResultError: there are more than ``MAX_LISTED``.
    """
    found: dict[str, Path] = {}
    for parent, folders, names in os.walk(folder):
        links = [name for name in folders if (Path(parent) / name).is_symlink()]
        for name in (*names, *links):
            path = Path(parent) / name
            found[path.relative_to(folder).as_posix()] = path
        if len(found) > MAX_LISTED:
            raise ResultError(f"{folder}: holds more than {MAX_LISTED} files; a result folder holds a few hundred")
    return dict(sorted(found.items()))


def write_manifest(folder: Path, data: Mapping[str, Any]) -> None:
    """Write the manifest of a complete folder; ``data`` is the content of its ``result.json``."""
    files = {name: hash_file(path) for name, path in list_files(folder).items() if name not in UNLISTED}
    _write(folder, Manifest(hash_certificate(data), files))


def forget_files(folder: Path, names: Iterable[str]) -> None:
    """Strike files that are about to be written from the manifest: an interrupt then leaves them unlisted, not wrong.

    A folder without a manifest, which an earlier version wrote, stays without one.

    Raises:
        ResultError: the manifest cannot be used.
    """
    manifest = read_manifest(folder)
    if manifest is not None and set(names) & set(manifest.files):
        kept = {name: value for name, value in manifest.files.items() if name not in set(names)}
        _write(folder, Manifest(manifest.certificate_sha256, kept))


def record_files(folder: Path, names: Iterable[str]) -> None:
    """Add files of a folder to its manifest, if it has one.

    Raises:
        ResultError: the manifest cannot be used.
    """
    manifest = read_manifest(folder)
    if manifest is not None:
        added = {name: hash_file(folder / name) for name in names}
        _write(folder, Manifest(manifest.certificate_sha256, {**manifest.files, **added}))


def read_manifest(folder: Path) -> Manifest | None:
    """Return the manifest of a folder; None without one.

    Raises:
        ResultError: the file is no manifest.
    """
    path = folder / MANIFEST_NAME
    if not path.is_file():
        return None
    try:
        if path.stat().st_size > MAX_MANIFEST_BYTES:
            raise ResultError(f"{MANIFEST_NAME} has more than {MAX_MANIFEST_BYTES} bytes")
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        raise ResultError(f"{MANIFEST_NAME} is no JSON") from None
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        got = data.get("format") if isinstance(data, dict) else data
        raise ResultError(f"{MANIFEST_NAME}: format is {shown(got)}; expected {FORMAT!r}")
    files, certificate = data.get("files"), data.get("certificate_sha256")
    if not isinstance(files, dict) or not all(isinstance(text, str) for text in (certificate, *files.values())):
        raise ResultError(f"{MANIFEST_NAME}: expected the texts certificate_sha256 and files, a hash by path")
    return Manifest(str(certificate), files)


def _write(folder: Path, manifest: Manifest) -> None:
    text = json.dumps({"format": FORMAT, "certificate_sha256": manifest.certificate_sha256, "files": manifest.files})
    replace_file(folder / MANIFEST_NAME, text.encode())
