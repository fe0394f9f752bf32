"""Hands: how hard they may press on a mechanism and how they give way, and the correction of those that are free."""
