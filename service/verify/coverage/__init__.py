"""Coverage of a certificate: required checks, pairs of links left out, links without shape."""
