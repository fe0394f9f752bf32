"""The rest of a task from one of its phases on: its phases, the earlier motion, and how far hands are from that."""
