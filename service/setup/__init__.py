"""A request made ready to plan: robot at its start, obstacles, and the scan's pieces around it."""
