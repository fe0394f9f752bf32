"""Plans that move a mechanism that the request gives."""
