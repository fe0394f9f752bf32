"""A plan's result, and the files it is written to and read from."""
