"""Beams that are none: rims and narrow sides, whose faces run on where a board would end."""

from __future__ import annotations

import numpy as np
import pytest

from perception import CONFIDENT, View, make_view
from perception.detect.beam.detector import detect_beam
from perception.detect.shared.bar_evidence import in_line, runs_on
from perception.detect.shared.bars import Bar
from perception.sightlines import Sightlines
from perception.simulate import Mesh, Pose, Scanner, box, scan

SENSOR = Pose((0.1, 0.0, 1.6), pitch=0.6)
SCANNER = Scanner(n_beams=541, fan_deg=160.0, n_lines=60)
RIM = (box((0.65, -0.9, 0.3), (1.4, -0.1, 0.9)), box((0.65, -0.9, 0.9), (0.68, -0.1, 1.02)))
SLAB = (box((1.17, 0.15, 0.7), (1.65, 0.25, 1.35)),)


def view_of(*meshes: Mesh) -> View:
    room = [box((-5.0, -5.0, -0.1), (5.0, 5.0, 0.0)), box((2.6, -3.0, 0.0), (2.7, 3.0, 2.5))]
    return make_view(scan([*room, *meshes], SENSOR, SCANNER, 0))


@pytest.mark.parametrize("meshes", [RIM, SLAB], ids=["the rim of a tub", "the narrow side of a slab"])
def test_what_is_the_edge_of_something_larger_is_no_beam(meshes: tuple[Mesh, ...]) -> None:
    assert all(one.confidence < CONFIDENT for one in detect_beam(view_of(*meshes)))


def ending_at(ends: np.ndarray) -> Sightlines:
    start = np.tile([-1.0, -1.0, 1.0], (len(ends), 1))
    length = np.linalg.norm(ends - start, axis=1)
    return Sightlines(start, (ends - start) / length[:, None], length)


def test_what_is_level_with_a_face_that_is_seen_is_in_line_with_it() -> None:
    # Along y, seen from before and above: its faces towards -x and +z are seen.
    bar = Bar(np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.zeros(3), (0.02, 0.05), -0.5, 0.5)
    ends = np.array(
        [
            [-0.02, 0.1, -0.2],  # below its front face
            [0.3, 0.1, 0.05],  # behind its top
            [0.02, 0.1, -0.2],  # below its back face, which nobody sees
            [0.3, 0.1, -0.05],  # behind its underside
            [0.3, 0.1, 0.12],  # higher than its top
            [-0.02, 0.1, 0.0],  # on it
            [-0.045, 0.1, -0.2],  # below and before its front face
            [1.5, 0.1, 0.05],  # far behind
        ]
    )
    assert in_line(bar, ending_at(ends)).tolist() == [True, True, False, False, False, False, False, False]
    pipe = Bar(bar.frame, bar.centre, (0.05, 0.05), -0.5, 0.5, "round")
    assert not in_line(pipe, ending_at(ends)).any()


def test_a_surface_runs_on_where_most_rays_meet_it_before_air_along_much_of_the_bar() -> None:
    level = np.array([True, True, False, True, False, False, True, False, False])
    outside = np.array([0.01, 0.02, 0.04, 0.03, 0.01, 0.02, 0.01, 0.02, 0.02])
    part = np.array([0, 0, 0, 1, 1, 2, 3, 3, 3])
    assert runs_on(level[:5], ~level[:5], outside[:5], part[:5], 3).tolist() == [True, False, False]
    assert not runs_on(level, ~level, outside, part, 5).any()
