"""Commands of an operator: plans on the robot of a server."""
