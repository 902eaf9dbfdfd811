"""The levels at which evidence counts: the budget of false alarms, and the odds between two models."""

from typing import Final

CHANCE: Final = 0.002
"""Probability that a search calls noise an effect, over all places where it looks."""
LOG_ODDS: Final = 6.0
"""Twice the log of the odds, beyond the prices of the parameters, from which the other of two models is taken: one in twenty that
it is luck (Kass and Raftery, JASA 90, 1995: 6 to 10 is strong evidence)."""
