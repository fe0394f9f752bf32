"""Safe search of the mesh files that a URDF names."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path, PurePosixPath

from costs.robot.errors import RobotError
from costs.robot.xmlfile import parse_xml, read_xml_text

SCHEMES = ("package", "model")
FILE = "file"  # an absolute path
MOST_FOLDERS = 2000  # subfolders of a package folder that are searched for a package.xml
_PACKAGE_FILE = "package.xml"
_LEVELS_UP = 5


def resolve_mesh(uri: str, roots: Sequence[Path], where: str) -> tuple[str, Path]:
    """Find the key and real path of a mesh inside one of ``roots``.

    ``package://name/rest`` (or ``model://``) is searched as ``root/name/rest``, as ``root/rest`` where root is itself
    the package, and in the subfolder of a root whose ``package.xml`` has the name; anything else as a path relative to
    a root. An absolute path, also as ``file://``, must lie inside a root. The key is the path a result folder stores
    the mesh under.

    Raises:
        RobotError: for other schemes, paths that leave all roots (also through symbolic links) and files that are not
            there.
    """
    if "$(" in uri or "${" in uri:
        raise RobotError(f"{where}: mesh '{uri}' is an expression of xacro; expand the file with the command xacro")
    scheme, separator, rest = uri.partition("://")
    if separator and scheme not in (*SCHEMES, FILE):
        raise RobotError(f"{where}: mesh '{uri}': {scheme}:// is refused; use package:// or a relative path")
    separator = "" if scheme == FILE else separator
    # A third slash is common in package:// and means nothing.
    relative = PurePosixPath(rest.removeprefix("/") if separator else rest or uri)
    if "\\" in uri or "\0" in uri:
        raise RobotError(f"{where}: mesh '{uri}' has a '\\'; write paths with '/'")
    if separator and relative.is_absolute():
        raise RobotError(f"{where}: mesh '{uri}' has an absolute path in {scheme}://; name the package it lies in")
    if separator and ".." in relative.parts:
        raise RobotError(f"{where}: mesh '{uri}': '..' is refused in package://; name the package it lies in")
    real_roots = [root.resolve() for root in roots]
    escaped = False
    for candidate, root in _list_candidates(relative, real_roots, is_package=bool(separator)):
        path = candidate.resolve()
        home = next((other for other in (root, *real_roots) if path.is_relative_to(other)), None)
        if home is None:
            escaped = True
        elif path.is_file():
            is_plain = not relative.is_absolute() and ".." not in relative.parts
            key = relative.as_posix() if is_plain else path.relative_to(home).as_posix()
            return key, path
    folders = ", ".join(str(root) for root in roots) or "none"
    if escaped:
        raise RobotError(
            f"{where}: mesh '{uri}' lies outside the package folders ({folders}); add its folder to package_dirs"
        )
    raise RobotError(
        f"{where}: mesh '{uri}' not found in the package folders ({folders}); add its folder to package_dirs"
    )


def find_package_folders(urdf: Path) -> tuple[Path, ...]:
    """Return the package that a URDF lies in and the folder with its neighbours; nothing where there is none.

    The package is the nearest folder above the URDF that has a ``package.xml`` or the name of a package in the URDF.
    """
    try:
        names = set(re.findall(r"(?:package|model)://([^/\"']+)/", read_xml_text(urdf)))
    except RobotError:
        names = set()
    folder = urdf.resolve().parent
    for above in (folder, *folder.parents)[:_LEVELS_UP]:
        if (above / _PACKAGE_FILE).is_file() or above.name in names:
            return above, above.parent
    return ()


def _list_candidates(
    relative: PurePosixPath, roots: Sequence[Path], *, is_package: bool
) -> Iterator[tuple[Path, Path]]:
    """Yield the places where a mesh may be, each with its root; packages found by ``package.xml`` last."""
    inside = PurePosixPath(*relative.parts[1:])
    for root in roots:
        yield root / relative, root
        if is_package and len(relative.parts) > 1 and relative.parts[0] == root.name:
            yield root / inside, root
    if not is_package or len(relative.parts) < 2:
        return
    for root in roots:
        for package in _list_packages(root):
            if _read_package_name(package) == relative.parts[0]:
                yield package / inside, root


def _list_packages(root: Path) -> Iterator[Path]:
    """Yield the folders with a ``package.xml``: the root, its subfolders and theirs."""
    level, seen = [root], 0
    for _ in range(3):
        below: list[Path] = []
        for folder in level:
            if (folder / _PACKAGE_FILE).is_file():
                yield folder
                continue
            try:
                children = sorted(child for child in folder.iterdir() if child.is_dir())
            except OSError:
                continue
            seen += len(children)
            if seen > MOST_FOLDERS:
                return
            below += children
        level = below


def _read_package_name(folder: Path) -> str:
    """Return the name that a folder's ``package.xml`` states; the folder's own where it cannot be read."""
    path = folder / _PACKAGE_FILE
    try:
        name = parse_xml(read_xml_text(path), str(path), "package").findtext("name")
    except RobotError:
        return folder.name
    return (name or "").strip() or folder.name
