"""Plans of a whole problem set with a summary table."""
