"""One engine for all kinds of objects: fit of a template's pose and sizes to rays, and what the rays say about it."""
