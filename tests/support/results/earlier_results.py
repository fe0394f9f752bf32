"""What earlier releases wrote, from tests/data/versions: result folders and stores, unpacked."""

from __future__ import annotations

import tarfile
from pathlib import Path

VERSIONS = Path(__file__).parents[2] / "data" / "versions"


def unpack(release: str, name: str, folder: Path) -> Path:
    """Unpack ``name`` (``reach``, ``store``, ...) of a release into a new folder, which is returned."""
    with tarfile.open(VERSIONS / release / f"{name}.tar.xz") as archive:
        extract(archive, folder)
    return folder


def extract(archive: tarfile.TarFile, folder: Path) -> None:
    """Unpack an archive; Python 3.11.4 brought filters, which later versions ask for."""
    archive.extractall(folder, **({"filter": "data"} if hasattr(tarfile, "data_filter") else {}))
