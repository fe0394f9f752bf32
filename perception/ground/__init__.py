"""The floor of a scan: its levels, how far each goes, and the pieces that stand for them."""
