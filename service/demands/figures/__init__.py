"""Figures of a result, measured on its motion by the code of the verifier."""
