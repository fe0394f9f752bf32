"""Lies told to the public faces of scopt, and cancels at random moments: ``make attack``."""
