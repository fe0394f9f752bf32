"""Attacks with false data on scopt's commands, and cancels at random moments: ``make attack``."""
