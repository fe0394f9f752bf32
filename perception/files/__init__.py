"""Cloud files of many kinds, read into clouds."""
