"""The options that choose, place and crop clouds, the same for every command that reads them."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import MISSING, asdict, dataclass, fields
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

Clouds = Annotated[list[Path], typer.Argument(help="Point cloud files; several are merged.", metavar="CLOUD...")]
Unit = Annotated[
    list[str] | None,
    typer.Option("--unit", help="Of the files' lengths: m (as by default), cm, mm, km, in, ft.", metavar="UNIT"),
]
Transforms = Annotated[
    list[str] | None,
    typer.Option(
        "--transform",
        help="Pose of the points in the world: 'X Y Z YAW PITCH ROLL' (radians), 'X Y Z QW QX QY QZ' or 16 numbers; "
        "once, or for each file.",
        metavar="NUMBERS",
    ),
]
Sensor = Annotated[
    list[str] | None, typer.Option("--sensor", help="Where rays started, if the files do not say.", metavar="'X Y Z'")
]
Viewpoint = Annotated[bool, typer.Option("--apply-viewpoint", help="The points are in the sensor's frame.")]
Topic = Annotated[str | None, typer.Option("--topic", help="Of a bag with clouds on several topics.")]
Message = Annotated[
    str, typer.Option("--message", help="Of a bag: number of the message, -1 for the last, or all.", metavar="NUMBER")
]
Radius = Annotated[float, typer.Option("--reach", help="Horizontal radius kept, in metres.", min=0.1, max=50.0)]
Top = Annotated[float, typer.Option("--top", help="Height up to which points are kept, in metres.")]
Bottom = Annotated[float, typer.Option("--bottom", help="Height from which on points are kept, in metres.")]
RobotThere = Annotated[
    str | None, typer.Option("--robot", help="Robot whose own points are left out: a bundled one, or a URDF.")
]
Posture = Annotated[
    Path | None,
    typer.Option("--posture", help="That robot's posture by name, or a file with its start (as in a request)."),
]
Seed = Annotated[int, typer.Option("--seed", help="Of all random choices.", min=0)]


@dataclass(frozen=True)
class CloudOptions:
    """Cloud files and how they are to be read, as they stand on a command line."""

    files: Clouds
    unit: Unit = None
    transforms: Transforms = None
    sensor: Sensor = None
    apply_viewpoint: Viewpoint = False
    topic: Topic = None
    message: Message = "0"
    reach_m: Radius = 4.0
    top_m: Top = 3.0
    bottom_m: Bottom = -0.5
    robot: RobotThere = None
    posture: Posture = None
    seed: Seed = 0

    def __post_init__(self) -> None:
        """
        Raises:
            typer.BadParameter: options that do not go together, or one twice that holds for all files.
        """
        if self.posture is not None and self.robot is None:
            raise typer.BadParameter("--posture needs --robot")
        for option, given in (("--unit", self.unit), ("--sensor", self.sensor)):
            if len(given or ()) > 1:
                raise typer.BadParameter(
                    f"{option} is given {len(given or ())} times; it holds for all clouds, give it once"
                )

    @property
    def inputs(self) -> list[Path]:
        """Every file that is read."""
        beside = [self.posture, None if self.robot is None else Path(self.robot)]
        return [*self.files, *(path for path in beside if path is not None)]

    def asked(self) -> dict[str, Any]:
        """What ``cloud_asked`` takes."""
        return {
            **asdict(self),
            "files": tuple(self.files),
            "unit": (self.unit or ["m"])[0],
            "transforms": tuple(self.transforms or ()),
            "sensor": self.sensor[0] if self.sensor else None,
        }


def with_cloud_options(command: Callable[..., None]) -> Callable[..., None]:
    """The command as typer is to see it: the files in place of its parameter ``clouds``, all else at the end."""
    hints = get_type_hints(CloudOptions, include_extras=True)
    shared = [
        inspect.Parameter(
            one.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=inspect.Parameter.empty if one.default is MISSING else one.default,
            annotation=hints[one.name],
        )
        for one in fields(CloudOptions)
    ]
    own = inspect.signature(command, eval_str=True).parameters.values()
    parameters = [*(shared[0] if one.name == "clouds" else one for one in own), *shared[1:]]

    @wraps(command)
    def called(**given: Any) -> None:
        clouds = CloudOptions(**{one.name: given.pop(one.name) for one in shared})
        command(**given, clouds=clouds)

    only_by_name = [one.replace(kind=inspect.Parameter.KEYWORD_ONLY) for one in parameters]
    called.__signature__ = inspect.Signature(only_by_name)  # type: ignore[attr-defined]
    return called
