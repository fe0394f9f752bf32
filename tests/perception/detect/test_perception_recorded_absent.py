"""Recorded scans show no objects of kinds that are not there."""

from __future__ import annotations

from pathlib import Path

import pytest

from perception import CONFIDENT, make_view, read_cloud
from perception.detect.registry import detect_each


@pytest.mark.parametrize(
    ("name", "kinds"),
    [
        ("scenes/door_a/scan0.pcd", ("wheel", "seat", "opening")),
        ("scenes/debris/scan0.pcd", ("wheel", "door")),
        ("scenes/valve_a/scan0.pcd", ("door", "seat", "opening")),
        ("scenes/car_ev/scan0.pcd", ("door",)),
        ("clouds/kinect_office_capture0001.pcd", ("panel", "lever")),
        ("clouds/mit_octomap_scene1.csv", ("wheel",)),
        ("clouds/eth_car_cloud400.csv", ("wheel",)),
    ],
)
def test_what_is_not_in_a_recorded_scan_is_not_found(shared_data: Path, name: str, kinds: tuple[str, ...]) -> None:
    for kind, hits in detect_each(kinds, make_view(read_cloud(shared_data / name))):
        assert [hit.confidence for hit in hits if hit.confidence >= CONFIDENT] == [], kind
