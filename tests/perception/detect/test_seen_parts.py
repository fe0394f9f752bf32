"""Parts that hands press: spokes that are there and spokes that are not, counted by the rays of a scan."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from perception import (
    Detection,
    SeenPart,
    ValveDetection,
    count_seen_parts,
    detect_kinds,
    make_view,
    read_clouds,
    rigid_pose,
    select_wheels,
)
from perception.cloud import Cloud
from perception.detect.door.model import DoorModel
from perception.simulate.scenes.doors import SCENES as DOORS
from perception.simulate.scenes.valves import SCENES as VALVES

SAME_SPOKE = np.deg2rad(12.0)


@cache
def scanned(name: str, seed: int, variant: str) -> tuple[Cloud, Detection]:
    """A simulated scan, and the best valve or door that it shows."""
    cloud = {**VALVES, **DOORS}[name].make(name, seed).scan(variant)
    view = make_view(cloud)
    return view.cloud, detect_kinds(("wheel" if name in VALVES else "door",), view)[0]


def list_angles(wheel: ValveDetection, n_spokes: int) -> np.ndarray:
    """Angles of spokes, less those of evenly spaced ones from the first on [rad]."""
    even = wheel.spoke_angles[0] + 2.0 * np.pi * np.arange(n_spokes) / n_spokes
    off = np.array(wheel.spoke_angles)[:, None] - even
    return np.abs((off + np.pi) % (2.0 * np.pi) - np.pi).min(axis=1)


@pytest.mark.parametrize(
    ("name", "seed", "variant", "n_spokes"),
    [
        ("valve_small", 63, "solid_sparse", 3),
        ("valve_near_wall", 64, "solid_sparse", 5),
        ("valve_plain", 61, "sparse", 4),
    ],
)
def test_a_wheel_has_the_spokes_that_rays_end_on(name: str, seed: int, variant: str, n_spokes: int) -> None:
    _, hit = scanned(name, seed, variant)
    (wheel,) = select_wheels([hit])
    assert len(wheel.spoke_angles) == n_spokes
    assert (list_angles(wheel, n_spokes) < SAME_SPOKE).all()


def test_the_shared_wheel_has_three_spokes(shared_data: Path) -> None:
    """At 90, 210 and 330 deg; the lower lip of its rim, seen from above, is none."""
    file = shared_data.parent / "cases" / "clouds" / "phantom_spoke" / "vis2.ply"
    if not file.is_file():
        pytest.skip(f"no case at {file}")
    turn = rigid_pose((0.0, 0.0, 0.0, 0.7071068, 0.7071068, 0.0, 0.0))
    cloud = read_clouds([(file, turn)], unit="mm", sensor=(0.1, 0.0, 1.6))
    (wheel,) = select_wheels(detect_kinds(("wheel",), make_view(cloud))[:1])
    assert np.rad2deg(wheel.spoke_angles) == pytest.approx([90.0, 210.0, 330.0], abs=4.0)


def near_rim(part: SeenPart, wheel: ValveDetection) -> tuple[int, int]:
    return part.count_near((wheel.rim_radius - wheel.tube_radius - 0.015, 0.0), 0.05)


@pytest.mark.parametrize("variant", ["sparse", "solid_sparse", "camera"])
def test_points_lie_on_spokes_that_are_there_and_rays_pass_through_others(variant: str) -> None:
    cloud, hit = scanned("valve_plain", 62, variant)
    (wheel,) = select_wheels([hit])
    between = 0.5 * (wheel.spoke_angles[0] + wheel.spoke_angles[1])
    wrong = replace(wheel, spoke_angles=(*wheel.spoke_angles, between))
    parts = count_seen_parts(cloud, replace(hit, model=wrong))
    assert [part.name for part in parts] == ["spoke/0", "spoke/1", "spoke/2", "spoke/3", "spoke/4", "rim"]
    for part in parts[:4]:
        n_points, n_through = near_rim(part, wheel)
        assert n_points >= 5
        assert n_through <= 0.3 * n_points
    n_points, n_through = near_rim(parts[4], wheel)
    assert n_through > 2 * n_points
    assert min(part for part in parts[5].hits) >= 5


@pytest.mark.parametrize(
    ("name", "handle", "variant"),
    [
        ("door_left_shut", "lever", "dense"),
        ("door_right_bar", "push bar", "sparse"),
    ],
)
def test_points_lie_on_the_bar_of_a_handle_where_it_is(name: str, handle: str, variant: str) -> None:
    """Of the same bar 40 cm higher, nearly all rays pass."""
    cloud, hit = scanned(name, 62, variant)
    leaf, bar = count_seen_parts(cloud, hit)
    assert (leaf.name, bar.name) == ("leaf", handle)
    assert sum(bar.hits) >= 6
    assert sum(bar.passes) <= 0.3 * sum(bar.hits)
    assert isinstance(hit.model, DoorModel)
    assert hit.model.geometry.handle is not None
    centre = hit.model.geometry.handle.centre + np.array([0.0, 0.0, 0.4])
    moved = replace(hit.model.geometry.handle, centre=centre)
    wrong = replace(hit.model, geometry=replace(hit.model.geometry, handle=moved))
    _, none = count_seen_parts(cloud, replace(hit, model=wrong))
    assert sum(none.passes) > 2 * sum(none.hits)


def test_only_cells_near_a_place_are_counted() -> None:
    part = SeenPart("bar", ((0.01, 0.0), (0.03, 0.0), (0.05, 0.0)), (1, 2, 4), (8, 16, 32), 0.02)
    assert part.count_near((0.04, 0.0), 0.015) == (6, 48)
    assert part.count_near((0.2, 0.0), 0.05) == (0, 0)
