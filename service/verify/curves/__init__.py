"""What the proofs know of polynomial curves: ranges of values, rates and sizes between instants."""
