"""Protocol buffers of the planner service."""
