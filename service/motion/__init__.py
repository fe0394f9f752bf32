"""From waypoints to a timed curve: spline, time law, and repair of what a certificate refutes."""
