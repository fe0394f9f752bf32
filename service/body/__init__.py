"""The whole body in contact: terms of every phase, phases, holds, and sampled paths."""
