"""Regions that frames reach or keep to: what they are, and the checks made of them."""
