"""Detection of valves: wheels and levers."""
