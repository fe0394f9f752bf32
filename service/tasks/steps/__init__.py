"""Planning of a list of steps."""
