"""Movable objects: who carries them in each phase, where they are, and proofs that grips and supports hold them."""
