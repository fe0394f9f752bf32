"""Detection of hose ends and standpipes."""
