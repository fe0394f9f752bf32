"""Measurements of the certificate: its time, and random problems that an independent judge checks."""
