"""The whole body in contact: terms of every phase, solver of phases, holds, and sampled paths."""
