"""Reasons why no motion was found: global ones, and the constraints that conflict locally."""
