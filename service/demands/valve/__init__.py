"""Demands of turning a valve."""
