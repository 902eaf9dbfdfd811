"""The budget of false alarms."""

CHANCE = 0.002
"""Probability that a search calls noise an effect, over all places where it looks."""
