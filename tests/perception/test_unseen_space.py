"""Where the space that a scan has seen ends without a surface."""

from __future__ import annotations

import numpy as np

from perception import Reach, list_unseen


def test_the_rim_of_a_shadow_is_unseen_and_a_seen_wall_is_not() -> None:
    sensor = np.zeros(3)
    y, z = np.meshgrid(np.linspace(-2.0, 2.0, 160), np.linspace(-2.0, 2.0, 160))
    wall = np.column_stack([np.full(y.size, 2.0), y.ravel(), z.ravel()])
    is_hidden = np.abs(wall[:, 1:]).max(axis=1) < 0.8  # behind a board of 0.8 m at x = 1
    board = np.where(is_hidden[:, None], 0.5 * wall, wall)
    reach = Reach(x=0.0, radius=3.0, top=2.0, bottom=-2.0)
    unseen = list_unseen((np.broadcast_to(sensor, board.shape), board), board, reach, ())
    off_axis = np.abs(unseen[:, 1:]).max(axis=1) / np.maximum(unseen[:, 0], 0.01)
    beside = unseen[(off_axis < 0.7) & (unseen[:, 0] > 0.3)]  # within what the sensor looks at
    # The shadow's sides, between board and wall; neither face of board and wall, and nothing before the board.
    assert len(beside) > 100
    assert beside[:, 0].min() > 1.0
    assert beside[:, 0].max() < 2.0
    share = np.abs(beside[:, 1:]).max(axis=1) / beside[:, 0]
    assert np.all(np.abs(share - 0.4) < 0.15)
