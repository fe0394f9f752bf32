"""A request: its schema as frozen dataclasses, and the files it is read from."""
