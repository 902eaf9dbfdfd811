"""The levels at which evidence counts: the budget of false alarms, and the odds between two models."""

from typing import Final

from galen_hw.diagnosis.stats.criteria import CRITERIA

CHANCE: Final = CRITERIA.chance
LOG_ODDS: Final = CRITERIA.log_odds
