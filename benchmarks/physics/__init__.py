"""Measurements of certified plans carried out in physics, and of the online control that carries them out."""
