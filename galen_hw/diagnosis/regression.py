"""What every regression of a model's rest on generic functions is asked for, however it learns them."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

from galen_hw.diagnosis.inner_products import Sums
from galen_hw.spatial import Array


@dataclass
class Regression(ABC):
    """Of one channel's rest on families of functions.

    Args:
        plain, white: inner products of the families, the plain ones first, as they are and whitened.
        rest, white_rest: (n,) over the noise's standard deviation, and whitened.
        weighed: fitted as whitened (generalised) or as it is: the first is best where noise is the rest's larger part, the
            second where physics is.
        chosen: families of which it takes something; reached, white_gain: falls of the sum of squares on folds left out.
    """

    plain: Sums
    white: Sums
    rest: Array
    white_rest: Array
    weighed: bool
    chosen: list[str] = field(init=False, default_factory=list)
    reached: float = field(init=False, default=0.0)
    white_gain: float = field(init=False, default=0.0)

    @abstractmethod
    def coefficients(self) -> dict[str, Array]:
        """(k,) of every function of the chosen families, in the channel's unit."""

    @abstractmethod
    def crossed(self) -> Array:
        """(n,) what is predicted of each row from other folds, over the noise's deviation."""
