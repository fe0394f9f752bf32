"""Plans that open a door."""
