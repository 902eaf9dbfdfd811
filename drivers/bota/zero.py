"""What a `zero` of a Bota sensor tells. The bias is the host's (`host_bias`), in N and N m.

The package has a tare of its own, which is left alone: it is refused while the sensor streams, so that the wrench would be
gone for more than half a second in the middle of the work; on most interfaces it is the package's own mean over samples, lost
with its process, where on the others the sensor keeps it and cannot be asked for it. The host's says what it took off, is
kept over a restart of the daemon, and goes when another sensor answers.
"""

from typing import Any

import numpy as np

from galen_hw.drivers.host_bias import Floats


def told(samples: Floats) -> dict[str, Any]:
    """Return bias and scatter of the samples (n, 6): N, N m."""
    mean, scatter = samples.mean(axis=0), samples.std(axis=0)
    return {
        "samples": len(samples),
        "bias_force_n": mean[:3].tolist(),
        "bias_torque_nm": mean[3:].tolist(),
        "std_force_n": np.asarray(scatter[:3]).tolist(),
        "std_torque_nm": np.asarray(scatter[3:]).tolist(),
    }
