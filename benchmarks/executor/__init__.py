"""Measurements of the pool of workers."""
