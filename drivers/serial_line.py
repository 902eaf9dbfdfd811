"""A change of the serial line itself, as an element of the bytes that a device sends."""

from dataclasses import dataclass
from typing import Self


@dataclass(frozen=True, slots=True)
class LineChange:
    """What to change.

    Args:
        baud_rate: from now on, after what was sent before has left; None: as it is.
        break_on: begin or end a break; None: as it is.
    """

    baud_rate: int | None = None
    break_on: bool | None = None


class LineControl(bytes):
    """No bytes, and a `LineChange` that a serial transport carries out in its turn between what is sent.

    Being bytes, it passes through every shell in the order in which the device wrote it; where there is no such line
    (a socket, memory), it is an empty write.

    Args:
        change: what to change.
    """

    change: LineChange

    def __new__(cls, change: LineChange) -> Self:
        """Empty bytes that bear `change`."""
        self = super().__new__(cls)
        self.change = change
        return self
