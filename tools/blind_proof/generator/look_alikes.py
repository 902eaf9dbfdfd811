"""How far a lag is from the best of all delays, and a delay from the best of all lags: what any test could go by at most.

To first order in the time both take off the same, the time times the rate: where noise covers the second order, no answer to
"which of the two" is more than a guess, whoever gives it.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from galen_hw.tools.blind_proof.generator import signal
from galen_hw.tools.blind_proof.generator.noise import spectrum

Array = NDArray[np.float64]
SHORTEST = 1e-6
"""Of what is tried in place of the true one, s."""


LOOK_ALIKES: dict[str, Callable[[Array, Array, float], Array]] = {
    "lag": signal.delayed,
    "time_delay": lambda t, x, seconds: signal.lagged(x, float(np.median(np.diff(t))), seconds),
}
"""By effect: the one that it may be taken for."""


def apart(key: str, t: Array, clean: Array, changed: Array, sigma: Array, noise: str) -> float:
    """Standard errors of the noise between a recording (N, c), changed by an effect, and the nearest with its look-alike.

    By all rows and channels together, with the noise's own spectrum, constants free: a test that knew both curves would
    mistake one for the other with the probability of a normal deviate beyond half of it.
    """
    weight = 1.0 / spectrum(np.asarray(np.fft.rfftfreq(len(t)), dtype=np.float64), noise)
    weight[0] = 0.0

    def distance(log_seconds: float) -> float:
        other = LOOK_ALIKES[key](t, clean, float(np.exp(log_seconds)))
        off = np.fft.rfft((changed - other) / sigma, axis=0)
        return float(np.sqrt(2.0 / len(t) * np.sum(weight[:, None] * np.abs(off) ** 2)))

    return float(minimize_scalar(distance, bounds=(np.log(SHORTEST), 0.0), method="bounded").fun)
