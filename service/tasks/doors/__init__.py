"""What the planner of doors asks of a leaf: places where it is pushed, and what it meets on its way."""
