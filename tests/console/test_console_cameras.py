"""Pictures of cameras: their sources, what they send, and where the plan's places are in them."""

from __future__ import annotations

import asyncio
import io

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from service.cli.console.cameras import CameraSource, parse_camera, read_marks, take_picture
from service.errors import ExecutionError, RequestError, ServiceError
from service.simulation.pictures import CameraPicture, project, write_png
from service.work.robot.pictures import PictureServer, Take


def test_a_camera_has_a_name_words_of_phases_and_an_address() -> None:
    assert parse_camera("head=http://a/b?x=1") == CameraSource("head", "http://a/b?x=1")
    assert parse_camera("feet@step+walk=http://a/b").phases == ("step", "walk")


@pytest.mark.parametrize(
    "text", ["", "head", "head=", "=http://a", "head=file:///etc/passwd", "head@=http://a", "head=http:"]
)
def test_what_is_no_camera_is_refused(text: str) -> None:
    with pytest.raises(RequestError, match="expected NAME=URL"):
        parse_camera(text)


@settings(max_examples=50, deadline=None)
@given(st.text(max_size=60) | st.sampled_from(['{"a": [2, 0]}', '{"a": ["x", 1]}', "[1]", '{"a": [0.1]}', "[" * 5000]))
def test_marks_of_any_source_are_shares_of_the_picture(text: str) -> None:
    assert all(0.0 <= x <= 1.0 for at in read_marks(text).values() for x in at)


def test_a_picture_comes_with_its_marks_and_what_gives_none_says_why() -> None:
    pixels = np.zeros((6, 8, 3), np.uint8)
    pixels[2, 3] = (255, 10, 20)

    def make() -> Take:
        def take(name: str) -> CameraPicture:
            if name == "dark":
                raise ExecutionError("there is nothing to see")
            return {"head": CameraPicture(write_png(pixels), {"r_hand": (0.5, 0.25)})}[name]

        return take

    server = PictureServer(0, make)
    where = f"http://127.0.0.1:{server.port}"
    cameras = [CameraSource(name, f"{where}/{name}.png") for name in ("head", "dark", "none")]
    try:
        got = asyncio.run(take_picture(cameras, "head"))
        assert got["image"].startswith("data:image/png;base64,")
        assert got["marks"] == {"r_hand": [0.5, 0.25]}
        for name, words in (("dark", "503 there is nothing to see"), ("none", "404 there is no such camera")):
            with pytest.raises(ServiceError, match=words):
                asyncio.run(take_picture(cameras, name))
        with pytest.raises(RequestError, match="there is no camera 'hed'; expected head"):
            asyncio.run(take_picture(cameras, "hed"))
    finally:
        server.close()
    with Image.open(io.BytesIO(write_png(pixels))) as image:
        assert np.array_equal(np.asarray(image), pixels)


def test_places_are_where_a_camera_sees_them() -> None:
    eye, aim = np.array([0.0, 0.0, 1.0]), np.array([2.0, 0.0, 1.0])
    places = {"ahead": aim, "left": np.array([2.0, 0.5, 1.0]), "above": np.array([2.0, 0.0, 1.4]), "behind": -aim}
    seen = project(eye, aim, 90.0, places)  # a quarter turn: at 2 m it sees 2 m up and down
    assert seen["ahead"] == pytest.approx((0.5, 0.5))
    assert seen["left"] == pytest.approx((0.5 - 0.125 * 240 / 320, 0.5))
    assert seen["above"] == pytest.approx((0.5, 0.4))
    assert "behind" not in seen
