"""Detection of button panels."""
