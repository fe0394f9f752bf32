"""A cloud made ready: what lies in reach, and which points surfaces stand for."""
