"""Stances of tasks that change contacts: surfaces, contacts in place, phases, and what a request makes of them."""
