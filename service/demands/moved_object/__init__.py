"""An object that a hand moves: what its joints demand of the hand, and whether it rests without one."""
