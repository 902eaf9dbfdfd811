"""The effects: one family a file."""
