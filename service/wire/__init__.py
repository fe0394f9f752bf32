"""Messages of the wire, and what they mean."""
