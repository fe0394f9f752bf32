"""Plans in a physics engine: the robot, its scene and its mechanism in MuJoCo, and what became of the plan."""
