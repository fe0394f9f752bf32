"""Feet of a robot on the ground: how they come down, keep the balance and share the weight."""
