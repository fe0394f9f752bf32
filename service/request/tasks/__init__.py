"""What a request may ask for: one module per kind of task, and the registry of the kinds."""
