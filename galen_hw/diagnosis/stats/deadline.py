"""The time that a search may take: a search that goes on patching what no effect explains has no end of its own."""

from dataclasses import dataclass, field
from math import inf
from time import monotonic


@dataclass
class Deadline:
    """Hold when to stop looking for better models.

    Args:
        seconds: by the wall clock, from now on.
        share: of these, after which it has passed.
        stopped: whether a search has asked and been told that it has.
    """

    seconds: float = inf
    share: float = field(init=False)
    stopped: bool = False
    begun: float = field(init=False)

    def __post_init__(self) -> None:
        """Look at the clock: a first look, on few rows, takes a third of what all take."""
        self.share = 1.0 / 3.0
        self.begun = monotonic()

    def extend(self) -> None:
        """Begin the search of all rows; what is found is judged in the last fifth of the time."""
        self.share, self.stopped = 0.8, False

    @property
    def note(self) -> list[str]:
        """Return what the answer says of a search that was stopped; of others nothing."""
        why = f"the search was stopped after {self.share * self.seconds:.3g} s, so that a better model may exist"
        return [f"{why}: --time-limit {2 * self.seconds:g} gives it twice as long"] if self.stopped else []

    def passed(self) -> bool:
        """Return whether the time is over, and keep that it was asked for in vain."""
        if monotonic() - self.begun <= self.share * self.seconds:
            return False
        self.stopped = True
        return True
