"""What a finding must show on held-out data to be told: one rule, whose levels stand here and nowhere else."""

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class Criteria:
    """Levels of the rule that every finding has to meet, see `paired.Gain.credible`.

    Args:
        standard_errors: by how many standard errors of the paired difference between blocks the error must fall; two leave 2.3 %
            of chance on one side (Vehtari, Gelman and Gabry, Statistics and Computing 27, 2017: elpd_diff beside se_diff).
        least_share: of the held-out excess over the noise that must fall away, as mean square, beside laws that are rough
            (friction, play, creep, drift) or where physics is missing: at 0.02 an effect is a seventh of what is missed.
        exact_share: the same beside laws that are exact (a body, a delay, a scale): three thousandths of their size, which is
            how well machines and their clocks are known (Kennedy and O'Hagan 2001: a law's own error is part of the noise).
        beside_unexplained: of what the whole model leaves of the excess: physics that is missing has a part along any regressor,
            and a name that takes less than a tenth of it may be that part (the discrepancy's variance of Kennedy and O'Hagan).
    """

    standard_errors: float = 2.0
    least_share: float = 0.02
    exact_share: float = 1e-5
    beside_unexplained: float = 0.1


CRITERIA: Final = Criteria()
