"""Random holds of mechanisms, planned and carried out in physics: what a certificate promises, and what moves."""
