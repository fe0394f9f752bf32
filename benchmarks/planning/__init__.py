"""Measurements of planning motions: time, memory and how many problems are solved."""
