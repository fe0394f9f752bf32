"""PTX files (Leica Cyclone, Faro Scene and others): scans as text grids of cells, each transformed by its pose."""

from __future__ import annotations

import codecs
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from perception.errors import CloudError
from perception.files.content import Content
from perception.files.pcd import IDENTITY_VIEWPOINT
from perception.files.scan import Scan, choose_step, note_thinning, parse_natural, pick_rows, quote
from perception.files.text import read_rows, skip_lines, use_line_feeds
from perception.limits import LARGEST_COORDINATE, MAX_FILE_POINTS, MAX_WHOLE_BYTES

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

# Numbers per header line: columns, rows, the scanner's position and three axes, four rows of the transformation.
HEADER_WIDTHS = (1, 1, 3, 3, 3, 3, 4, 4, 4, 4)
_RIGID_TOLERANCE = 1e-3  # for numbers written with few digits
_APART_M = 0.01
# A grid is used if this percentage of its returns agrees with its angles.
_NEARLY_ALL = 95.0
_LARGEST_MISFIT = np.radians(1.0)
_FEWEST_POINTS = 10
_FEWEST_LINES = 5


@dataclass(frozen=True)
class _Station:
    """One scan of the file.

    Attributes:
        number: number of the scan, from 1.
        shape: columns and rows of its grid.
        rotation, position: pose of its cells in the file's frame; the scanner is at the cells' origin.
        header_position: scanner position given in the header, in the file's frame.
        start, stop: byte range of its cells.
        first_line: line number of the first cell.
    """

    number: int
    shape: tuple[int, int]
    rotation: Float[np.ndarray, "3 3"]
    position: Float[np.ndarray, "3"]
    header_position: Float[np.ndarray, "3"]
    start: int
    stop: int
    first_line: int

    @property
    def n_cells(self) -> int:
        return self.shape[0] * self.shape[1]


def read_ptx(data: Content, name: str) -> Scan:
    """Read the points of all scans in the file's frame, thinned to at most ``MAX_POINTS``.

    A cell of zeros is a ray without a return.  Its direction follows from the other cells of its column and row; its
    free distance, which the file does not give, is set to the median range of the scan.

    Raises:
        CloudError: the file cannot be used; the message names ``name``, the line and the fault.
    """
    data = use_line_feeds(data, b"")
    stations = _read_stations(data, name)
    n_cells = sum(station.n_cells for station in stations)
    if not n_cells:
        raise CloudError(f"{name}: its {len(stations)} scans have no cells; at least one is needed")
    stations = [station for station in stations if station.n_cells]
    step = max(choose_step(n_cells), -(-len(data) // MAX_WHOLE_BYTES))
    parts = [_read_cells(data, station, step, name) for station in stations]
    points = np.concatenate([points for points, _, _ in parts])
    misses = np.concatenate([misses for _, misses, _ in parts])
    notes = (*note_thinning(n_cells, step), *(note for station in stations for note in _note_position(station)))
    if len(misses):
        notes = (*notes, f"{len(misses)} cells without a return count as free up to their scan's median range")
    if n_silent := sum(silent for _, _, silent in parts):
        notes = (*notes, f"{n_silent} cells have no return, and where their rays went does not follow from the grid")
    if not any(station.position.any() or not np.array_equal(station.rotation, np.eye(3)) for station in stations):
        return Scan(points, IDENTITY_VIEWPOINT, misses=misses, notes=notes)
    if len(stations) == 1:
        return Scan(points, misses=misses, starts=stations[0].position, notes=notes)
    positions = np.stack([station.position for station in stations])
    starts = np.repeat(positions, [len(points) for points, _, _ in parts], axis=0)
    miss_starts = np.repeat(positions, [len(misses) for _, misses, _ in parts], axis=0)
    return Scan(points, misses=misses, starts=starts, miss_starts=miss_starts, notes=notes)


def _read_stations(data: Content, name: str) -> list[_Station]:
    stations: list[_Station] = []
    at, line = len(codecs.BOM_UTF8) if data[:3] == codecs.BOM_UTF8 else 0, 1
    n_cells = 0
    while True:
        while at < len(data) and (end := skip_lines(data, at, 1)) >= 0 and not data[at:end].strip():
            at, line = end, line + 1
        if at >= len(data):
            break
        numbers: list[list[float]] = []
        for width in HEADER_WIDTHS:
            end = skip_lines(data, at, 1)
            if end < 0:
                raise CloudError(f"{name}: ends in the header of scan {len(stations) + 1}, which has 10 lines")
            numbers.append(_parse_numbers(data[at:end], width, f"{name}: line {line}", len(stations) + 1))
            at, line = end, line + 1
        shape = int(numbers[0][0]), int(numbers[1][0])
        n_here = shape[0] * shape[1]
        n_cells += n_here
        if n_cells > MAX_FILE_POINTS:
            raise CloudError(f"{name}: its scans announce {n_cells} cells; at most {MAX_FILE_POINTS} are read")
        stop = skip_lines(data, at, n_here)
        if stop < 0:
            there = data[at:].count(b"\n") + (data[-1:] != b"\n")
            raise CloudError(
                f"{name}: scan {len(stations) + 1} announces {shape[0]} columns of {shape[1]} cells, {there} lines "
                "follow its header"
            )
        rotation, position = _check_pose(numbers[6:], name, line)
        header_position = np.array(numbers[2])
        stations.append(_Station(len(stations) + 1, shape, rotation, position, header_position, at, stop, line))
        at, line = stop, line + n_here
    if not stations:
        raise CloudError(f"{name}: holds no scan; at least one is needed")
    return stations


def _parse_numbers(content: bytes, width: int, where: str, scan: int) -> list[float]:
    words = content.decode("latin-1").split()
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = []
    is_right = len(values) == width and bool((np.abs(values) <= LARGEST_COORDINATE).all())
    if not is_right or (width == 1 and parse_natural(words[0]) is None):
        wanted = "a number of columns or rows" if width == 1 else f"{width} numbers"
        raise CloudError(f"{where}: '{quote(' '.join(words))}' is not {wanted}, as the header of scan {scan} has there")
    return values


def _check_pose(
    rows: list[list[float]], name: str, line: int
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:
    """Return rotation and position of the transformation; the file applies it to row vectors from the right."""
    matrix = np.array(rows).T
    rotation = matrix[:3, :3]
    is_rigid = np.abs(rotation @ rotation.T - np.eye(3)).max() < _RIGID_TOLERANCE and np.linalg.det(rotation) > 0.0
    if not is_rigid or not np.array_equal(matrix[3], [0.0, 0.0, 0.0, 1.0]):
        raise CloudError(
            f"{name}: lines {line - 4} to {line - 1} are no rigid transformation; three rows of a rotation and a 0, "
            "then the position and a 1, are needed"
        )
    return rotation, matrix[:3, 3]


def _read_cells(
    data: Content, station: _Station, step: int, name: str
) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "M 3"], int]:
    """Return points and ends of rays without a return in the file's frame, and the number of cells not used."""
    rows = read_rows(
        data,
        range(3),
        name,
        start=station.start,
        stop=station.stop,
        n_rows=station.n_cells,
        first_line=station.first_line,
        step=step,
    )
    if rows.n_there != station.n_cells:
        raise CloudError(
            f"{name}: scan {station.number} announces {station.n_cells} cells, {rows.n_there} of as many lines are some"
        )
    local = rows.values
    is_point = np.isfinite(local).all(axis=1) & (np.abs(local) <= LARGEST_COORDINATE).all(axis=1) & local.any(axis=1)
    cells = np.arange(station.n_cells)[pick_rows(station.n_cells, step)]
    points = local[is_point]
    directions = _find_missed_directions(points, cells[is_point], cells[~is_point], station.shape)
    reach = float(np.median(np.linalg.norm(points, axis=1))) if len(points) else 0.0
    misses = reach * directions
    to_file = station.rotation.T
    n_silent = len(local) - len(points) - len(misses)
    return points @ to_file + station.position, misses @ to_file + station.position, n_silent


def _note_position(station: _Station) -> tuple[str, ...]:
    """Return a note if the header's scanner position differs from the origin of the cells."""
    if np.abs(station.header_position - station.position).max() <= _APART_M:
        return ()
    stated, zero = (
        ", ".join(f"{value:g}" for value in np.round(position, 3) + 0.0)
        for position in (station.header_position, station.position)
    )
    return (
        f"the header of scan {station.number} has its scanner at ({stated}), its transformation at ({zero}), where "
        "rays are taken to start",
    )


def _find_missed_directions(
    points: Float[np.ndarray, "N 3"], cells: Int[np.ndarray, "N"], missed: Int[np.ndarray, "K"], shape: tuple[int, int]
) -> Float[np.ndarray, "M 3"]:
    """Return the directions of cells without a return, as far as the grid determines them.

    A column has one azimuth and a row one elevation; both are averaged over its cells with a return, or interpolated
    from neighbouring columns and rows.  Files list cells column by column or row by row: the order that fits the points
    is used; if neither fits, no direction is returned.

    Args:
        points: (N, 3) points in the scanner's frame, none at the origin.
        cells: (N,) their indices in the list of cells.
        missed: (K,) indices of the cells without a return.
        shape: columns and rows of the grid.

    Returns:
        (M, 3) unit vectors, M <= K.
    """
    if len(points) < _FEWEST_POINTS or not len(missed):
        return np.zeros((0, 3))
    rays = points / np.linalg.norm(points, axis=1, keepdims=True)
    n_columns, n_rows = shape
    orders = [
        _AngleGrid(rays, cells // n_rows, cells % n_rows, shape),
        _AngleGrid(rays, cells % n_columns, cells // n_columns, shape),
    ]
    best = min(orders, key=lambda grid: grid.misfit)
    if best.misfit > min(best.spacing, _LARGEST_MISFIT):
        return np.zeros((0, 3))
    if best is orders[0]:
        directions = best.compute_directions(missed // n_rows, missed % n_rows)
    else:
        directions = best.compute_directions(missed % n_columns, missed // n_columns)
    return np.asarray(directions[np.isfinite(directions).all(axis=1)])


class _AngleGrid:
    """Azimuth of each column and elevation of each row, averaged over the rays [rad].

    Attributes:
        misfit: 95th percentile of the angle between rays and grid [rad].
        spacing: angle between neighbouring columns or rows, the larger of both [rad].
    """

    def __init__(
        self,
        rays: Float[np.ndarray, "N 3"],
        columns: Int[np.ndarray, "N"],
        rows: Int[np.ndarray, "N"],
        shape: tuple[int, int],
    ) -> None:
        sums = [np.bincount(columns, rays[:, axis], shape[0]) for axis in (0, 1)]
        is_column = np.bincount(columns, minlength=shape[0]) > 0
        self._azimuth = _interpolate_lines(np.unwrap(np.arctan2(sums[1], sums[0])[is_column]), is_column)
        n_in_row = np.bincount(rows, minlength=shape[1])
        elevations = np.bincount(rows, np.arcsin(np.clip(rays[:, 2], -1.0, 1.0)), shape[1])
        self._elevation = _interpolate_lines((elevations / np.maximum(n_in_row, 1))[n_in_row > 0], n_in_row > 0)
        off = np.linalg.norm(self.compute_directions(columns, rows) - rays, axis=1)
        self.misfit = float(np.percentile(off, _NEARLY_ALL))
        self.spacing = max(_measure_spacing(self._azimuth), _measure_spacing(self._elevation))

    def compute_directions(self, columns: Int[np.ndarray, "K"], rows: Int[np.ndarray, "K"]) -> Float[np.ndarray, "K 3"]:
        """Return (K, 3) unit vectors of cells; NaN if the angle of the column or row is unknown."""
        azimuth, elevation = self._azimuth[columns], self._elevation[rows]
        flat = np.where(np.abs(elevation) <= 0.5 * np.pi, np.cos(elevation), np.nan)
        return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=1)


def _interpolate_lines(known: Float[np.ndarray, "K"], is_known: Bool[np.ndarray, "L"]) -> Float[np.ndarray, "L"]:
    """Return the angle of each line (column or row): known, or interpolated between known lines.

    Outside the known lines it is extrapolated if these are evenly spaced, else it is NaN.
    """
    lines, places = np.arange(len(is_known)), np.flatnonzero(is_known)
    values = np.interp(lines, places, known, left=np.nan, right=np.nan)
    if len(known) < _FEWEST_LINES:
        return np.asarray(values)
    step = (known[-1] - known[0]) / (places[-1] - places[0])
    if np.abs(known - known[0] - step * (places - places[0])).max() < 0.5 * abs(step):
        values[: places[0]] = known[0] + step * (lines[: places[0]] - places[0])
        values[places[-1] + 1 :] = known[-1] + step * (lines[places[-1] + 1 :] - places[-1])
    return np.asarray(values)


def _measure_spacing(angles: Float[np.ndarray, "L"]) -> float:
    """Return the median angle between neighbours [rad]."""
    steps = np.abs(np.diff(angles[np.isfinite(angles)]))
    return float(np.median(steps)) if len(steps) else 0.0
