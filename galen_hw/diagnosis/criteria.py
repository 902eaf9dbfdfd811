"""What a finding must show on held-out data to be told: one rule, whose levels stand here and nowhere else."""

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class Criteria:
    """Levels of the rule that every finding has to meet, see `paired.Gain.credible`.

    Args:
        standard_errors: by how many standard errors of the paired difference between blocks the error must fall; two leave 2.3 %
            of chance on one side (Vehtari, Gelman and Gabry, Statistics and Computing 27, 2017: elpd_diff beside se_diff).
        least_share: of the held-out excess over the noise that must fall away, as mean square: at 0.01 an effect is a tenth of
            what the simulation misses, which is what the laws of friction, play or creep themselves may be off by, see
            `verdict.FORM`.
    """

    standard_errors: float = 2.0
    least_share: float = 0.01


CRITERIA: Final = Criteria()
