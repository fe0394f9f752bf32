"""Errors of the verifier: only wrong input raises, a motion that fails is a certificate that says so."""


class VerifyError(ValueError):
    """A motion that cannot be checked as it was handed over; the message names the field and the value."""
