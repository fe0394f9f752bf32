"""The rest of a plan: the earlier motion, kept where it can be, and plans from one of its phases on."""
