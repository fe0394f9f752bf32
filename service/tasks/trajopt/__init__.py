"""Plans of problem files."""
