"""Measurements of what an operator leads by hand."""
