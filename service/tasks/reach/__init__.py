"""Plans of reaches."""
