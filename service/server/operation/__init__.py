"""Handlers of what operators do: lead poses, find stored plans, and carry them out."""
