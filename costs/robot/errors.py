"""Error of the robot loader."""


class RobotError(ValueError):
    """A robot file, option or name that cannot be used; one line that names it, the value and what is expected."""
