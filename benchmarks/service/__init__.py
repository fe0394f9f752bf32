"""What the planning service does under load and whatever is sent to it: ``python -m benchmarks.service``."""
