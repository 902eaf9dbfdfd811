"""Operators with a state: filters, play, friction, gaps."""
