"""The readings' noise: its spectrum, and what grows ever slower."""
