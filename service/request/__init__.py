"""Requests: schema as frozen dataclasses, and reading of request files."""
