"""Tells of an ATI board's gauges when it is zeroed; the bias itself is the host's (`host_bias`), in counts before the matrix."""

from typing import Any

import numpy as np
import numpy.typing as npt

from galen_hw.drivers.ati_netcanoem.codec import ABNORMAL_NOISE_COUNTS, GAUGES, WIRE_ORDER


def told(counts: npt.NDArray[np.float64]) -> dict[str, Any]:
    """For gauges 0 to 5: bias and scatter, and whether the gauges were as quiet as the manual wants."""
    in_order = counts[:, [WIRE_ORDER.index(gauge) for gauge in range(GAUGES)]]
    spread = np.ptp(in_order, axis=0)
    return {
        "samples": len(in_order),
        "bias_counts": in_order.mean(axis=0).tolist(),
        "std_counts": in_order.std(axis=0).tolist(),
        "peak_to_peak_counts": spread.tolist(),
        "quiet": bool((spread <= ABNORMAL_NOISE_COUNTS).all()),
    }
