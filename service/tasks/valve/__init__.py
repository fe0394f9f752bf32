"""Plans that turn a valve."""
