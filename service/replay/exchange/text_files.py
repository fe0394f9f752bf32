"""Trajectories in text files and NumPy archives: YAML, JSON, CSV and NPZ."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Iterator, Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from costs.robot import BASE_NAMES
from service.errors import RequestError, shown
from service.replay.exchange.fields import MAX_DEPTH
from service.replay.exchange.joint_trajectory import MAX_POINTS, JointTrajectory
from service.replay.exchange.messages import FIELDS, TIMES, parse_trajectory
from service.result.motion_json import BASE_COLUMNS

MAX_TEXT_BYTES = 64 * 2**20
MAX_YAML_BYTES = 16 * 2**20  # its parser takes a second for 3 MB
BASE_ARRAYS = ("base_poses", "base_velocities")
RATE_PREFIXES = {"velocity.": "velocities", "acceleration.": "accelerations"}


def read_text_trajectory(path: Path) -> JointTrajectory:
    """Read a YAML, JSON, CSV or NPZ file.

    Raises:
        RequestError: the file cannot be read, or holds no trajectory; the message names the file.
    """
    kind = path.suffix.lower()
    content = read_bytes(path, MAX_YAML_BYTES if kind in (".yaml", ".yml") else MAX_TEXT_BYTES)
    if kind == ".npz":
        return _read_archive(content, path.name)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise RequestError(f"{path.name}: is no UTF-8 text (byte {error.start})") from None
    if kind == ".csv":
        return _read_table(text, path.name)
    data = _parse_json(text, path.name) if kind == ".json" else _parse_yaml(text, path.name)
    return parse_trajectory(data, path.name)


def read_bytes(path: Path, most: int) -> bytes:
    """Return a file's content.

    Raises:
        RequestError: it is missing, no file, or larger than ``most`` bytes.
    """
    try:
        if not path.is_file():
            raise RequestError(f"{path.name}: {'is not a file' if path.exists() else 'does not exist'}")
        size = path.stat().st_size
        if size > most:
            raise RequestError(f"{path.name}: is {size} bytes long; expected at most {most}")
        with path.open("rb") as file:
            return file.read(most)
    except OSError as error:
        raise RequestError(f"{path.name}: cannot be read: {error.strerror}") from None


def _read_table(text: str, source: str) -> JointTrajectory:
    """Read a CSV file: ``time``, a column per joint, and perhaps ``velocity.JOINT`` and ``acceleration.JOINT``."""
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    if len(lines) > MAX_POINTS + 1:
        raise RequestError(f"{source}: has {len(lines) - 1} points; expected 2 to {MAX_POINTS}")
    header = [cell.strip().strip('"') for cell in lines[0].split(",")] if lines else []
    if len(header) < 2 or all(_is_number(cell) for cell in header):
        raise RequestError(f"{source}: its first line must name the columns: time, then one per joint")
    table = np.array(list(_read_rows(lines[1:], len(header), source)), dtype=float).reshape(-1, len(header))
    time_columns = [k for k, name in enumerate(header) if name in (*TIMES, "t")]
    if len(time_columns) > 1:
        raise RequestError(f"{source}: has several columns of times: {', '.join(header[k] for k in time_columns)}")
    groups: dict[str, list[int]] = {"positions": [], "velocities": [], "accelerations": []}
    for column, name in enumerate(header):
        prefix = next((prefix for prefix in RATE_PREFIXES if name.startswith(prefix)), None)
        if column not in time_columns:
            groups["positions" if prefix is None else RATE_PREFIXES[prefix]].append(column)
    names = tuple(header[k].removeprefix("position.") for k in groups["positions"])
    rates = {field: {header[k].split(".", 1)[1]: k for k in groups[field]} for field in ("velocities", "accelerations")}
    rate_names = tuple(rates["velocities"] or rates["accelerations"])
    columns: dict[str, np.ndarray | None] = {}
    for field, by_name in rates.items():
        if by_name and set(by_name) != set(rate_names):
            odd = sorted(set(by_name) ^ set(rate_names))
            raise RequestError(f"{source}: {shown(odd[0])} has a velocity or an acceleration, not both")
        columns[field] = table[:, [by_name[name] for name in rate_names]] if by_name else None
    times = table[:, time_columns[0]] if time_columns else None
    return JointTrajectory(
        names,
        times,
        table[:, groups["positions"]],
        columns["velocities"],
        columns["accelerations"],
        rate_names=() if rate_names == names else rate_names,
        source=source,
    )


def _read_rows(lines: list[str], width: int, source: str) -> Iterator[list[float]]:
    for row, line in enumerate(lines):
        cells = line.split(",")
        if len(cells) != width:
            raise RequestError(f"{source}: point {row} has {len(cells)} columns; expected {width}")
        try:
            yield [float(cell) for cell in cells]
        except ValueError:
            bad = next(cell for cell in cells if not _is_number(cell))
            raise RequestError(f"{source}: point {row} holds {shown(bad.strip())}; a number is needed") from None


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _parse_json(text: str, source: str) -> object:
    try:
        return json.loads(text, object_pairs_hook=_make_object)
    except (ValueError, RecursionError) as error:
        raise RequestError(f"{source}: is no JSON: {shown(str(error))}") from None


def _make_object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Refuse a repeated key, of which a reader would take only one."""
    members = dict(pairs)
    if len(members) < len(pairs):
        repeated = next(key for number, (key, _) in enumerate(pairs) if key in dict(pairs[:number]))
        raise ValueError(f"an object has the key {shown(repeated)} twice")
    return members


class _StrictLoader(yaml.CSafeLoader):
    """Reader of YAML that refuses a repeated key."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        made: dict[Any, Any] = super().construct_mapping(node, deep=deep)
        if len(made) < len(node.value):
            keys = [key.value for key, _ in node.value]
            repeated = next(key for number, key in enumerate(keys) if key in keys[:number])
            raise yaml.YAMLError(f"a mapping has the key {shown(repeated)} twice")
        return made


def _parse_yaml(text: str, source: str) -> object:
    """Return the only document of a YAML file; ``ros2 topic echo`` ends each with ``---``."""
    depth = 0
    try:
        for event in yaml.parse(text, Loader=yaml.CSafeLoader):
            if isinstance(event, yaml.AliasEvent):
                raise RequestError(f"{source}: alias '*{event.anchor}' is not read; write the value out")
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > MAX_DEPTH:
                raise RequestError(f"{source}: nested deeper than {MAX_DEPTH} levels")
        documents = [one for one in yaml.load_all(text, Loader=_StrictLoader) if one is not None]
    except (yaml.YAMLError, ValueError, OverflowError) as error:
        raise RequestError(f"{source}: no valid YAML: {shown(str(error))}") from None
    if len(documents) != 1:
        raise RequestError(f"{source}: holds {len(documents)} documents; expected one trajectory")
    return documents[0]


def _read_archive(content: bytes, source: str) -> JointTrajectory:
    """Read an NPZ file with the arrays joint_names, positions, and times or dt (``numpy.savez``)."""
    try:
        with zipfile.ZipFile(BytesIO(content)) as archive:
            unpacked = sum(entry.file_size for entry in archive.infolist())
        if unpacked > MAX_TEXT_BYTES:
            raise RequestError(f"{source}: unpacks to {unpacked} bytes; expected at most {MAX_TEXT_BYTES}")
        with np.load(BytesIO(content), allow_pickle=False) as archive_data:
            data = {key: archive_data[key] for key in archive_data.files}
    except RequestError:
        raise
    except Exception as error:  # zipfile, zlib and numpy raise many types
        raise RequestError(f"{source}: is no archive of numpy.savez: {shown(str(error))}") from None
    plain = {key: value.tolist() if value.ndim else value.item() for key, value in data.items()}
    for field in FIELDS["positions"]:
        if field in data and data[field].ndim == 3 and len(data[field]) == 1:  # a batch of one, as cuRobo writes
            plain = {key: value[0] if data[key].ndim == 3 else value for key, value in plain.items()}
    trajectory = parse_trajectory({key: value for key, value in plain.items() if key not in BASE_ARRAYS}, source)
    return trajectory if "base_poses" not in data else _add_base(trajectory, data)


def _add_base(trajectory: JointTrajectory, data: Mapping[str, np.ndarray]) -> JointTrajectory:
    """Return the trajectory with a floating base, whose arrays ``scopt export --to numpy`` writes beside the joints.

    Accelerations are left out, since those of the base are not there.
    """
    poses, source = data["base_poses"], trajectory.source
    if poses.shape != (len(trajectory.positions), len(BASE_COLUMNS)):
        raise RequestError(f"{source}: base_poses has the shape {poses.shape}; expected one row of 7 numbers per point")
    velocities, own = trajectory.velocities, data.get("base_velocities")
    if velocities is not None:
        if own is None or own.shape != (len(poses), len(BASE_NAMES)):
            raise RequestError(f"{source}: base_velocities is missing, or not one row of 6 numbers per point")
        velocities = np.hstack([own.astype(float), velocities])
    dropped = (
        ()
        if trajectory.accelerations is None
        else ("accelerations are not used, since those of the base are not known",)
    )
    return JointTrajectory(
        (*BASE_COLUMNS, *trajectory.joint_names),
        trajectory.times,
        np.hstack([poses.astype(float), trajectory.positions]),
        velocities,
        rate_names=(*BASE_NAMES, *trajectory.joint_names),
        source=source,
        notes=(*trajectory.notes, *dropped),
    )
