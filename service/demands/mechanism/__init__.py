"""Demands of moving a mechanism that the request gives."""
