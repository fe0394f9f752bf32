"""Detection of doors."""
