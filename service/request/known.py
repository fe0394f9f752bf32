"""What a scene is made with besides clouds: known objects, and what an earlier scan of the same place showed."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, StrictBool
from pydantic.dataclasses import dataclass
from pydantic_core import PydanticCustomError

from service.request.fields import SECTION, FilePath, Label, Number, Point, Quaternion, Section, at_most


@dataclass(config=SECTION)
class KnownMeshRequest(Section):
    """An object whose shape is known, as ``scopt scene --mesh`` takes it.

    Attributes:
        file: STL, OBJ, PLY or URDF.
        name: of its pieces; by default that of the file.
        scale: metres per unit of the file.
        position: where it stands, or about where it is looked for; everywhere without it.
        quaternion_wxyz: how it is turned there; without it, it may be turned in any way, or not at all if it is placed.
        is_placed: whether it stands exactly there; else the scan tells where.
    """

    file: FilePath
    name: Label | None = None
    scale: Annotated[Number, Field(ge=1e-6, le=1e6)] = 1.0
    position: Point | None = None
    quaternion_wxyz: Quaternion | None = None
    is_placed: StrictBool = False

    def __post_init__(self) -> None:
        if self.position is None and (self.quaternion_wxyz is not None or self.is_placed):
            raise PydanticCustomError("known_mesh", "a pose needs a position; give position as well")
        if self.name is not None and "/" in self.name:
            raise PydanticCustomError("known_mesh", "name: one without '/' would do, which its pieces have")


@dataclass(config=SECTION)
class KnownRequest(Section):
    """Known objects, and a scene file that the clouds are held against."""

    meshes: Annotated[tuple[KnownMeshRequest, ...], at_most(20)] = ()
    update: FilePath | None = None

    @property
    def files(self) -> tuple[str, ...]:
        """All files, as they are named."""
        return (*(mesh.file for mesh in self.meshes), *(() if self.update is None else (self.update,)))
