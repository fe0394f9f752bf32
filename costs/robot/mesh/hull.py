"""Convex hulls of link shapes, and outer hulls: few vertices whose hull contains a body closely.

An outer hull starts as a greedy choice of the body's own vertices.  Its hull lies inside the body, so a sequence of
linear programmes moves the vertices outwards: each minimises the greatest excess while every face stays outside the
body.  A last scaling about the centre makes the containment exact.
"""

from __future__ import annotations

from functools import lru_cache

import highspy
import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array, csc_array

from costs.robot.errors import RobotError

FLAT_SHARE = 1e-3
"""Thickness that a flat mesh gets, as a share of its extent."""

LEAST_EXTENT_M = 1e-4
"""Extent of a mesh below which it says nothing about its body."""

MOST_NEIGHBOURS = 250
"""Neighbours of a vertex; coal keeps 255."""

EXACT_VERTICES = 32
"""Most vertices of a body that is its own outer hull."""

_COUNTS = (32, 40, 48)
_TARGET_EXCESS = 3e-3
_RELATIVE_TARGET = 0.02
_ITERATIONS = 12
_GAIN = 0.01  # share of the excess; four steps in a row that gain less end the optimisation
_FEW_GAINS = 4
_FACE_ROWS = 3
_EXCESS_ROWS = 6


def thicken_flat_points(points: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "W 3"]:
    """Return points with those of a plane or line doubled across it, a little apart; others as they are.

    The distance is ``FLAT_SHARE`` of the extent.
    """
    _, axes = np.linalg.eigh(np.cov(points.T))
    heights = (points - points.mean(axis=0)) @ axes
    extent = np.ptp(heights, axis=0)
    half = 0.5 * FLAT_SHARE * float(extent.max())
    for axis in axes.T[extent <= 1e-9 * extent.max()]:
        points = np.vstack([points - half * axis, points + half * axis])
    return points


def find_hull_vertices(points: Float[np.ndarray, "V 3"], where: str) -> Float[np.ndarray, "W 3"]:
    """Find the vertices of the convex hull of ``points``, in their order.

    Raises:
        RobotError: the points lie in a plane, or nearly at one place.
    """
    from scipy.spatial import ConvexHull, QhullError  # slow to import

    extent = float(np.ptp(points, axis=0).max())
    if extent < LEAST_EXTENT_M:
        raise RobotError(f"{where}: all its points are within {extent:.3g} m; a body needs a size")
    try:
        hull = ConvexHull(points)
    except QhullError:
        raise RobotError(f"{where}: its points lie in a plane; a body needs a volume") from None
    return np.ascontiguousarray(points[np.sort(hull.vertices)])


def has_crowded_vertex(vertices: Float[np.ndarray, "V 3"]) -> bool:
    """Return whether a vertex of the hull's triangles has more neighbours than coal keeps."""
    from scipy.spatial import ConvexHull  # slow to import

    if len(vertices) <= MOST_NEIGHBOURS:
        return False
    return bool(np.bincount(ConvexHull(vertices).simplices.ravel()).max() > MOST_NEIGHBOURS)


def make_outer_hull(vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "W 3"]:
    """Make at most 48 points whose hull contains the hull of ``vertices``.

    Aims at an excess (height above the body's nearest face plane) of 3 mm or 2 % of the body's extent, whichever is
    less, with 32 points where these are expected to be enough, else with 40 or 48.
    """
    if len(vertices) <= EXACT_VERTICES:
        return vertices
    return _reduce(np.ascontiguousarray(vertices, dtype=float).tobytes()).copy()


@lru_cache(maxsize=256)
def _reduce(corners: bytes) -> Float[np.ndarray, "W 3"]:
    """Make the outer hull of (V, 3) corners given as bytes; cached, since the same robot is loaded many times."""
    from scipy.spatial import ConvexHull  # slow to import

    vertices = np.frombuffer(corners).reshape(-1, 3)
    target = min(_TARGET_EXCESS, _RELATIVE_TARGET * float(np.ptp(vertices, axis=0).max()))
    planes = ConvexHull(vertices).equations
    points = _choose_inner_points(vertices, target)
    best, best_excess = points, np.inf
    step, n_idle = 0.01 * float(np.ptp(vertices, axis=0).max()), 0
    solver = _make_solver()
    for _ in range(_ITERATIONS):
        points = points + _find_best_move(solver, points, vertices, planes, step)
        points = points[ConvexHull(points).vertices]
        outer = _scale_around(points, vertices)
        excess = _measure_excess(outer, planes)
        n_idle = 0 if excess < (1.0 - _GAIN) * best_excess else n_idle + 1
        if excess < best_excess:
            best, best_excess = outer, excess
        else:
            step *= 0.6
        if best_excess <= target or n_idle == _FEW_GAINS:
            break
    return best


def _choose_inner_points(vertices: Float[np.ndarray, "V 3"], target: float) -> Float[np.ndarray, "W 3"]:
    """Choose vertices one by one, each the farthest from the hull of those before."""
    from scipy.spatial import ConvexHull  # slow to import

    chosen = _choose_tetrahedron(vertices)
    while True:
        equations = ConvexHull(vertices[chosen]).equations
        gap = (vertices @ equations[:, :3].T + equations[:, 3]).max(axis=1)
        # The optimisation brings the excess a little below the gap that the inner hull leaves.
        if len(chosen) >= _COUNTS[-1] or (len(chosen) in _COUNTS and gap.max() <= 1.2 * target):
            return np.asarray(vertices[chosen])
        chosen.append(int(np.argmax(gap)))


def _choose_tetrahedron(vertices: Float[np.ndarray, "V 3"]) -> list[int]:
    """Choose four vertices that do not lie in a plane, each far from those before."""
    first = int(np.argmax(vertices[:, 0]))
    relative = vertices - vertices[first]
    chosen = [first]
    for _ in range(3):
        chosen.append(int(np.argmax(np.linalg.norm(relative, axis=1))))
        axis = relative[chosen[-1]] / np.linalg.norm(relative[chosen[-1]])
        # What remains is the distance from the line, then from the plane, through the vertices chosen so far.
        relative = relative - np.outer(relative @ axis, axis)
    return chosen


def _make_solver() -> highspy.Highs:
    """Return a solver for programmes of some hundred rows, which presolve would only delay."""
    solver = highspy.Highs()
    solver.silent()
    solver.setOptionValue("presolve", "off")
    return solver


def _find_best_move(
    solver: highspy.Highs,
    points: Float[np.ndarray, "W 3"],
    vertices: Float[np.ndarray, "V 3"],
    planes: Float[np.ndarray, "F 4"],
    step: float,
) -> Float[np.ndarray, "W 3"]:
    """Find moves of at most ``step`` per coordinate that minimise the greatest excess, to first order.

    Unknowns are the moves and the excess t.  A face (a, b, c) with normal n stays outside the body's vertex v when
    the moves' heights along n, weighted by the barycentric coordinates of v's foot on the face, make up for v's
    height above it.
    """
    n_unknowns = points.size + 1
    face_rows, face_columns, face_values, face_limits = _make_face_rows(points, vertices)
    height = points @ planes[:, :3].T + planes[:, 3]
    nearest = np.argpartition(-height, min(_EXCESS_ROWS, height.shape[1]) - 1, axis=1)[:, :_EXCESS_ROWS]
    point = np.repeat(np.arange(len(points)), nearest.shape[1])
    plane = nearest.ravel()
    excess_rows = len(face_limits) + np.arange(len(plane))
    rows = np.concatenate([face_rows, np.repeat(excess_rows, 3), excess_rows])
    columns = np.concatenate([face_columns, (3 * point[:, None] + np.arange(3)).ravel(),
                              np.full(len(plane), n_unknowns - 1)])  # fmt: skip
    values = np.concatenate([face_values, planes[plane, :3].ravel(), np.full(len(plane), -1.0)])
    limits = np.concatenate([face_limits, -height[point, plane]])
    matrix = coo_array((values, (rows, columns)), shape=(len(limits), n_unknowns)).tocsc()
    unknowns = _minimise_last(solver, matrix, limits, step)
    if unknowns is None:
        # No move of this size gets every face outside: go outwards from the centre and let the scaling do the rest.
        outward = points - vertices.mean(axis=0)
        return np.asarray(step * outward / np.linalg.norm(outward, axis=1, keepdims=True))
    return np.asarray(unknowns[:-1].reshape(-1, 3))


def _minimise_last(
    solver: highspy.Highs, matrix: csc_array, limits: Float[np.ndarray, "m"], step: float
) -> Float[np.ndarray, "k"] | None:
    """Minimise the last unknown subject to ``matrix @ x <= limits``; the others stay within ``step`` of 0.

    Return None where there is no solution.
    """
    program = highspy.HighsLp()
    program.num_row_, program.num_col_ = matrix.shape
    bound = np.append(np.full(matrix.shape[1] - 1, step), highspy.kHighsInf)
    program.col_cost_ = np.append(np.zeros(matrix.shape[1] - 1), 1.0)
    program.col_lower_, program.col_upper_ = -bound, bound
    program.row_lower_, program.row_upper_ = np.full(matrix.shape[0], -highspy.kHighsInf), limits
    rows = program.a_matrix_
    rows.format_ = highspy.MatrixFormat.kColwise
    rows.start_, rows.index_, rows.value_ = matrix.indptr, matrix.indices, matrix.data
    solver.passModel(program)
    solver.run()
    if solver.getModelStatus() != highspy.HighsModelStatus.kOptimal:
        return None
    return np.array(solver.getSolution().col_value)


def _make_face_rows(
    points: Float[np.ndarray, "W 3"], vertices: Float[np.ndarray, "V 3"]
) -> tuple[Int[np.ndarray, "k"], Int[np.ndarray, "k"], Float[np.ndarray, "k"], Float[np.ndarray, "m"]]:
    """Make rows, columns, values and right-hand sides that keep the highest vertices below every face."""
    from scipy.spatial import ConvexHull  # slow to import

    hull = ConvexHull(points)
    normals = hull.equations[:, :3]
    height = normals @ vertices.T + hull.equations[:, 3:]
    highest = np.argpartition(-height, _FACE_ROWS - 1, axis=1)[:, :_FACE_ROWS]
    face = np.repeat(np.arange(len(normals)), highest.shape[1])
    vertex = highest.ravel()
    above = height[face, vertex]
    corners = points[hull.simplices[face]]
    foot = vertices[vertex] - above[:, None] * normals[face]
    weights = _compute_barycentric(foot, corners)
    values = -weights[:, :, None] * normals[face][:, None, :]
    columns = 3 * hull.simplices[face][:, :, None] + np.arange(3)
    rows = np.broadcast_to(np.arange(len(face))[:, None, None], values.shape)
    return rows.ravel(), columns.ravel(), values.ravel(), -above


def _compute_barycentric(
    points: Float[np.ndarray, "k 3"], corners: Float[np.ndarray, "k 3 3"]
) -> Float[np.ndarray, "k 3"]:
    """Compute barycentric coordinates of points, each in the plane of its own triangle."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    across = np.cross(first, second)
    area = np.maximum((across * across).sum(axis=1), 1e-30)
    offset = points - corners[:, 0]
    of_first = (np.cross(offset, second) * across).sum(axis=1) / area
    of_second = (np.cross(first, offset) * across).sum(axis=1) / area
    return np.asarray(np.stack([1.0 - of_first - of_second, of_first, of_second], axis=1))


def _scale_around(points: Float[np.ndarray, "W 3"], vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "W 3"]:
    """Scale the points' hull about its centre by the least factor with which it contains all vertices."""
    from scipy.spatial import ConvexHull  # slow to import

    centre = points.mean(axis=0)
    equations = ConvexHull(points).equations
    offset = -(equations[:, 3] + equations[:, :3] @ centre)
    support = ((vertices - centre) @ equations[:, :3].T).max(axis=0)
    # A few units in the last place more, so that rounding does not leave a vertex outside.
    factor = max(1.0, float((support / offset).max())) * (1.0 + 1e-9)
    return np.asarray(centre + factor * (points - centre))


def _measure_excess(points: Float[np.ndarray, "W 3"], planes: Float[np.ndarray, "F 4"]) -> float:
    """Return the greatest height of a point above the body's face planes [m]."""
    return float((points @ planes[:, :3].T + planes[:, 3]).max())
