"""The significance levels of all decisions."""

from dataclasses import dataclass
from typing import Final

from scipy.special import ndtri


@dataclass(frozen=True)
class Criteria:
    """Levels of the rules that a search and a finding have to meet.

    Args:
        chance: probability that noise passes for an effect: one budget a recording, shared among all that is asked of it.
        log_odds: twice the log of the odds, beyond the penalty of the parameters, from which the other of two models is taken
            (Kass and Raftery, JASA 90, 1995: 6 to 10 is strong evidence).
        least_share: of the held-out excess over the noise that a finding takes at least, as mean square, unless noise alone is
            left with it and more without it: at 0.02 it is a seventh of what is missed, and the laws beside it may miss as much
            of what they speak of (Kennedy and O'Hagan 2001: a law's own error is part of the noise) as long as nothing shows
            that they do not.
        beside_unexplained: of what the whole model leaves of the excess: missing physics has a part along any regressor,
            and what takes less than a quarter of it may be that part, as may a difference between two models (the discrepancy's
            variance of Kennedy and O'Hagan). What belongs to moments fits nearly anything, and has to take all of it.
        outstanding: mean square during a contact over that at all other times, from which it is judged by its own rows, and is
            an event: three times as large.
        noise_alone: mean square over that of the noise up to which noise alone is left: its level is learnt, and no better known.
    """

    chance: float = 0.002
    log_odds: float = 6.0
    least_share: float = 0.02
    beside_unexplained: float = 0.25
    outstanding: float = 9.0
    noise_alone: float = 1.25

    @property
    def beyond_noise(self) -> float:
        """Mean square over that of the noise from which more than noise is left: both that are compared may be off."""
        return 1.0 + 2.0 * (self.noise_alone - 1.0)

    def standard_errors(self, questions: int = 1) -> float:
        """Return the required number of standard errors of one of so many tests (Bonferroni, one side)."""
        return float(-ndtri(self.chance / max(questions, 1)))


CRITERIA: Final = Criteria()
