"""Messages of the wire: their conversion to plain data and back, checks, hashes, and refusals of calls."""
