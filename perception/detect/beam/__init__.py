"""Detection of sawn beams."""
