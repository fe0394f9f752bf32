"""Handlers of what operators do with stored plans: find them, and carry them out."""
