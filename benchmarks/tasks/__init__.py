"""Measurements of tasks: doors, valves, steps and getting out of a vehicle, drawn and from scans."""
