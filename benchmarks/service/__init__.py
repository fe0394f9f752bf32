"""Measurements of the planning service under load and hostile input: ``python -m benchmarks.service``."""
