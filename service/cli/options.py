"""Options that several commands share."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from service.request.choices import SensorModel

Json = Annotated[bool, typer.Option("--json", help="Print exactly one JSON object on stdout.")]


@dataclass(frozen=True)
class CloudOptions:
    """Cloud files and how to read them."""

    files: Annotated[list[Path], typer.Argument(help="Point cloud files; several are merged.", metavar="CLOUD...")]
    unit: Annotated[
        list[str] | None,
        typer.Option(help="Of the files' lengths: m (as by default), cm, mm, km, in, ft.", metavar="UNIT"),
    ] = None
    transforms: Annotated[
        list[str] | None,
        typer.Option(
            "--transform",
            help="Pose of the points in the world: 'X Y Z YAW PITCH ROLL' (radians), 'X Y Z QW QX QY QZ' or 16 "
            "numbers; once, or for each file.",
            metavar="NUMBERS",
        ),
    ] = None
    sensor: Annotated[
        list[str] | None, typer.Option(help="Where rays started, if the files do not say.", metavar="'X Y Z'")
    ] = None
    apply_viewpoint: Annotated[
        bool, typer.Option("--apply-viewpoint", help="The points are in the sensor's frame.")
    ] = False
    level: Annotated[
        bool, typer.Option("--level", help="Turn the cloud z up and put its floor at 0, after any transform.")
    ] = False
    sensor_model: Annotated[
        SensorModel,
        typer.Option(help="Kind of sensor, for its noise; auto: by the files, or estimated."),
    ] = "auto"
    sensor_sigma: Annotated[
        float,
        typer.Option(help="Standard deviation of where rays started, in metres.", min=0.0, max=1.0),
    ] = 0.0
    topic: Annotated[str | None, typer.Option(help="Of a bag with clouds on several topics.")] = None
    message: Annotated[
        str, typer.Option(help="Of a bag: number of the message, -1 for the last, or all.", metavar="NUMBER")
    ] = "0"
    reach_m: Annotated[float, typer.Option("--reach", help="Horizontal radius kept, in metres.", min=0.1, max=50.0)] = (
        3.0
    )
    top_m: Annotated[float, typer.Option("--top", help="Height up to which points are kept, in metres.")] = 3.0
    bottom_m: Annotated[float, typer.Option("--bottom", help="Height from which on points are kept, in metres.")] = -0.5
    robot: Annotated[
        str | None, typer.Option(help="Robot whose own points are left out: a bundled one, or a URDF.")
    ] = None
    posture: Annotated[
        Path | None, typer.Option(help="That robot's posture by name, or a file with its start (as in a request).")
    ] = None
    seed: Annotated[int, typer.Option(help="Of all random choices.", min=0)] = 0

    def __post_init__(self) -> None:
        """Raise ``typer.BadParameter`` for options that exclude each other or are repeated."""
        if self.posture is not None and self.robot is None:
            raise typer.BadParameter("--posture needs --robot")
        for option, values in (("--unit", self.unit), ("--sensor", self.sensor)):
            if values is not None and len(values) > 1:
                raise typer.BadParameter(
                    f"{option} is given {len(values)} times; it holds for all clouds, give it once"
                )

    @property
    def inputs(self) -> list[Path]:
        """Every file that is read."""
        return [*self.files, *(Path(path) for path in (self.posture, self.robot) if path is not None)]

    def to_settings(self) -> dict[str, Any]:
        """Return the settings for ``parse_cloud_options``."""
        return {
            **asdict(self),
            "files": tuple(self.files),
            "unit": (self.unit or ["m"])[0],
            "transforms": tuple(self.transforms or ()),
            "sensor": self.sensor[0] if self.sensor else None,
        }


@dataclass(frozen=True)
class ServerOptions:
    """Server of a client command, and the client's credentials."""

    target: Annotated[
        str, typer.Option(help="Server: HOST:PORT or unix:PATH.", envvar="SCOPT_TARGET", show_default=False)
    ]
    tls_ca: Annotated[Path | None, typer.Option(help="Authority of the server's certificate (PEM); turns TLS on.")] = (
        None
    )
    tls_cert: Annotated[
        Path | None, typer.Option(help="Certificate of this client (PEM), if the server requires one.")
    ] = None
    tls_key: Annotated[Path | None, typer.Option(help="Private key of that certificate (PEM).")] = None
    token_file: Annotated[
        Path | None, typer.Option(help="File with the token; by default the variable SCOPT_TOKEN.")
    ] = None
