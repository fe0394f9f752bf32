"""Where to stand for a task with a mechanism: places ranked by geometry, then checked by single poses."""
