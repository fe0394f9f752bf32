"""Readers and writers of cloud files in many formats."""
