"""What a whole model is worth."""

import numpy as np

from galen_hw.diagnosis.estimation.model import Model


def merit(model: Model, *, foretelling: bool = False) -> float:
    """Fall of the whitened sum of squares on the training rows less the price of the parameters.

    Args:
        foretelling: what lasts pays for what it would lose on blocks left out (Akaike 1974), not for being the truth (Schwarz
            1978): beside what was itself judged on such blocks.
    """
    train, price = model.bench.train, 0.0
    for h in model.effects:
        lasts = h.effect is not None and not h.effect.EPISODIC
        price += h.owed(whole=True) * (2.0 if foretelling and lasts else h.price(model.bench))
    fall = np.sum(model.bench.whitened(model.bench.whole)[train] ** 2) - np.sum(model.rest(white=True)[train] ** 2)
    return float(fall - price)
