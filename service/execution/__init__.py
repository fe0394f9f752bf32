"""Plans carried out on a robot: what it is told, what it measures, and who decides what comes next."""
