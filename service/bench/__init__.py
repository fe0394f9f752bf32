"""Plans of a whole problem set, summed up in one table."""
