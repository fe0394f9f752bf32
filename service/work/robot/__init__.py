"""Robots that plans are carried out on: simulated ones and drivers, each in a process of its own."""
