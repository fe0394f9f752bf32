"""From waypoints to a timed curve: spline, time law, and repair where a certificate fails."""
