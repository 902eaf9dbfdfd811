"""The significance levels of all decisions."""

from dataclasses import dataclass
from typing import Final

from scipy.special import ndtri


@dataclass(frozen=True)
class Criteria:
    """Significance levels of the search and of findings.

    Args:
        chance: false-alarm probability of a recording, shared among all tests (Bonferroni).
        log_odds: twice the log of the odds, beyond the penalty of the parameters, from which the other of two models is taken
            (Kass and Raftery, JASA 90, 1995: 6 to 10 is strong evidence).
        least_share: share of the held-out excess over the noise, as mean square, that a finding explains at least, unless the
            residual is noise alone with it and more without it. At 0.02 it is a seventh of the amplitude; the other laws may
            have as large a discrepancy (Kennedy and O'Hagan 2001: a law's own error is part of the noise).
        beside_unexplained: share of the unexplained excess that an effect explains at least: missing physics is correlated with
            any regressor, and a smaller gain, or difference between two models, may be that correlation (model discrepancy).
            Momentary effects fit nearly anything, and have to explain as much as remains.
        outstanding: mean square during a contact over that at all other times, from which it is judged by its own rows, and is
            an event: three times the amplitude.
        noise_alone: mean square over that of the noise up to which the residual is noise alone: the noise level is an estimate.
    """

    chance: float = 0.002
    log_odds: float = 6.0
    least_share: float = 0.02
    beside_unexplained: float = 0.25
    outstanding: float = 9.0
    noise_alone: float = 1.25

    @property
    def beyond_noise(self) -> float:
        """Mean square over that of the noise from which there is more than noise: both levels are estimates."""
        return 1.0 + 2.0 * (self.noise_alone - 1.0)

    def standard_errors(self, questions: int = 1) -> float:
        """Return the required number of standard errors of one of so many tests (Bonferroni, one side)."""
        return float(-ndtri(self.chance / max(questions, 1)))


CRITERIA: Final = Criteria()
