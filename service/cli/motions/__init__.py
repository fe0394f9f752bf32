"""Commands that plan a motion of a task file or of a single step."""
