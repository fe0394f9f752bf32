"""Trajectories in text files and NumPy archives: YAML, JSON, CSV and NPZ."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from costs.robot import BASE_NAMES
from service.errors import RequestError, shown
from service.replay.exchange.joint_trajectory import LONGEST_S, MAX_JOINTS, MAX_POINTS, JointTrajectory
from service.result.motion_json import BASE_COLUMNS

MAX_TEXT_BYTES = 64 * 2**20
MAX_YAML_BYTES = 16 * 2**20  # its parser takes a second for 3 MB
MAX_DEPTH = 12
NAMES = ("joint_names", "names", "name", "joints")
TIMES = ("times", "time", "time_from_start", "timestamps")
FIELDS = {
    "positions": ("positions", "position", "q"),
    "velocities": ("velocities", "velocity", "qd", "v"),
    "accelerations": ("accelerations", "acceleration", "qdd", "a"),
}
STEPS = ("dt", "interpolation_dt", "time_step")
# Keys under which messages and results of other planners hold the trajectory itself.
NESTED = ("joint_trajectory", "trajectory", "interpolated_plan", "planned_trajectory", "solution", "result")
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


def parse_trajectory(data: object, source: str) -> JointTrajectory:
    """Make a trajectory of a message (JointTrajectory, RobotTrajectory, DisplayTrajectory), of columns, or of states.

    Raises:
        RequestError: the data hold no trajectory, or several.
    """
    body, depth = data, 0
    while True:
        depth += 1
        if depth > MAX_DEPTH:
            raise RequestError(f"{source}: holds no trajectory")
        if isinstance(body, list | tuple) and len(body) == 1 and not _is_state(body[0]):
            body = body[0]
        elif isinstance(body, list | tuple) and body and all(_is_state(entry) for entry in body):
            return _read_states(body, source)
        elif isinstance(body, list | tuple):
            raise RequestError(f"{source}: holds {len(body)} trajectories; expected one")
        elif not isinstance(body, Mapping):
            raise RequestError(f"{source}: holds no trajectory; expected joint_names and points, got {shown(body)}")
        elif "points" in body:
            return _read_points(body, source)
        elif any(key in body for key in FIELDS["positions"]):
            return _read_columns(body, source)
        else:
            inner = [key for key in NESTED if key in body]
            if not inner:
                raise RequestError(
                    f"{source}: holds no trajectory; expected joint_names with points, or with positions and times, "
                    f"got the keys {shown(sorted(map(str, body)))}"
                )
            body = body[inner[0]]


def _is_state(entry: object) -> bool:
    return isinstance(entry, Mapping) and any(key in entry for key in FIELDS["positions"]) and _take_names(entry) != ()


def _read_points(body: Mapping[str, Any], source: str) -> JointTrajectory:
    """Read a JointTrajectory message, as ``ros2 topic echo`` prints it."""
    names = _check_names(_take_names(body), source)
    points = body["points"]
    if not isinstance(points, list | tuple) or not all(isinstance(point, Mapping) for point in points):
        raise RequestError(f"{source}: points must be a list of mappings, got {shown(points)}")
    if len(points) > MAX_POINTS:
        raise RequestError(f"{source}: has {len(points)} points; expected 2 to {MAX_POINTS}")
    columns = {
        field: _stack([_take(point, keys) for point in points], len(names), field, source)
        for field, keys in FIELDS.items()
    }
    stamps = [_take(point, TIMES) for point in points]
    return _build(names, _read_stamps(stamps, source), columns, source)


def _read_states(states: Sequence[Mapping[str, Any]], source: str) -> JointTrajectory:
    """Read a list of states (Tesseract), each of which names its joints, in any order."""
    if len(states) > MAX_POINTS:
        raise RequestError(f"{source}: has {len(states)} points; expected 2 to {MAX_POINTS}")
    names = _check_names(_take_names(states[0]), source)
    columns: dict[str, list[Any]] = {field: [] for field in FIELDS}
    for row, state in enumerate(states):
        own = _check_names(_take_names(state), source)
        if sorted(own) != sorted(names):
            other = sorted(set(own) ^ set(names))
            raise RequestError(
                f"{source}: state {row} has other joints than the first: {shown(other[0] if other else own)}"
            )
        order = [own.index(name) for name in names]
        for field, keys in FIELDS.items():
            values = _take(state, keys)
            is_row = isinstance(values, list | tuple) and len(values) == len(own)
            columns[field].append([values[k] for k in order] if is_row else values)
    stacked = {field: _stack(rows, len(names), field, source) for field, rows in columns.items()}
    return _build(names, _read_stamps([_take(state, TIMES) for state in states], source), stacked, source)


def _read_columns(body: Mapping[str, Any], source: str) -> JointTrajectory:
    """Read columns: joint_names, times (or a step ``dt``), positions, and perhaps velocities and accelerations."""
    names = _check_names(_take_names(body), source)
    columns = {}
    for field, keys in FIELDS.items():
        rows = _take(body, keys)
        if rows is not None and not isinstance(rows, list | tuple | np.ndarray):
            raise RequestError(f"{source}: {field} must be one list per point, got {shown(rows)}")
        columns[field] = None if rows is None or len(rows) == 0 else _stack(list(rows), len(names), field, source)
    times, step = _take(body, TIMES), _take(body, STEPS)
    stamps: np.ndarray | None = None
    if times is not None:
        stamps = _read_stamps(list(times) if isinstance(times, list | tuple | np.ndarray) else [times], source)
    elif step is not None:
        value = _to_number(step, "dt", source)
        if not 0.0 < value <= LONGEST_S:
            raise RequestError(f"{source}: dt is {value:g}; expected a step of more than 0 s")
        count = 0 if columns["positions"] is None else len(columns["positions"])
        stamps = value * np.arange(count)
    return _build(names, stamps, columns, source)


def _build(
    names: tuple[str, ...], times: np.ndarray | None, columns: Mapping[str, np.ndarray | None], source: str
) -> JointTrajectory:
    positions = columns["positions"]
    if positions is None:
        raise RequestError(f"{source}: has no positions")
    return JointTrajectory(names, times, positions, columns["velocities"], columns["accelerations"], source=source)


def _take(body: Mapping[str, Any], keys: Sequence[str]) -> Any:
    """Return the value of the first of several keys that is there; empty lists count as missing."""
    for key in keys:
        value = body.get(key)
        if value is not None and not (isinstance(value, list | tuple) and not value):
            return value
    return None


def _take_names(body: Mapping[str, Any]) -> object:
    value = _take(body, NAMES)
    return () if value is None else value


def _check_names(names: object, source: str) -> tuple[str, ...]:
    if isinstance(names, np.ndarray):
        names = names.tolist()
    if not isinstance(names, list | tuple) or not names or not all(isinstance(name, str) for name in names):
        raise RequestError(f"{source}: joint_names must be a list of texts, got {shown(names)}")
    if len(names) > MAX_JOINTS:
        raise RequestError(f"{source}: has {len(names)} joints; expected at most {MAX_JOINTS}")
    return tuple(names)


def _stack(rows: list[Any], width: int, field: str, source: str) -> np.ndarray | None:
    """Return rows as an array; None where no row holds anything."""
    if all(row is None for row in rows):
        return None
    for index, row in enumerate(rows):
        if isinstance(row, np.ndarray):
            row = rows[index] = row.tolist() if row.ndim == 1 else row
        if not isinstance(row, list | tuple) or len(row) != width:
            held = f"{len(row)} numbers" if isinstance(row, list | tuple) else "none" if row is None else shown(row)
            raise RequestError(f"{source}: point {index} has {held} as {field}; expected {width}, one per joint")
    try:
        return np.array([[_to_number(value, field, source) for value in row] for row in rows], dtype=float)
    except OverflowError:
        raise RequestError(f"{source}: {field} holds a number beyond all limits") from None


def _to_number(value: object, field: str, source: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        raise RequestError(f"{source}: {field} holds {shown(value)}; a number is needed")
    return float(value)


def _read_stamps(stamps: list[Any], source: str) -> np.ndarray | None:
    """Return times in seconds: numbers, or seconds and nanoseconds as ROS 1 and ROS 2 name them."""
    if all(stamp is None for stamp in stamps):
        return None
    return np.array([_read_stamp(stamp, row, source) for row, stamp in enumerate(stamps)], dtype=float)


def _read_stamp(stamp: Any, row: int, source: str) -> float:
    if isinstance(stamp, Mapping):
        whole = stamp.get("sec", stamp.get("secs"))
        part = stamp.get("nanosec", stamp.get("nsecs", 0))
        if whole is not None:
            return _to_number(whole, "time_from_start", source) + 1e-9 * _to_number(part, "time_from_start", source)
    if stamp is None or isinstance(stamp, Mapping):
        raise RequestError(f"{source}: point {row} has no time; expected seconds, or sec and nanosec")
    return _to_number(stamp, "time", source)


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
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise RequestError(f"{source}: is no JSON: {shown(str(error))}") from None


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
        documents = [one for one in yaml.load_all(text, Loader=yaml.CSafeLoader) if one is not None]
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
    trajectory = parse_trajectory(plain, source)
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
    return JointTrajectory(
        (*BASE_COLUMNS, *trajectory.joint_names),
        trajectory.times,
        np.hstack([poses.astype(float), trajectory.positions]),
        velocities,
        rate_names=(*BASE_NAMES, *trajectory.joint_names),
        source=source,
    )
