"""Motions that change contacts: poses on what stays, and the phases between stances."""
