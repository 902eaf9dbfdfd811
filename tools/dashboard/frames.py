"""What a page may send: one typed frame each, told apart by `do`; everything else is refused in words.

Every frame bears a number of the page's own, which the answer repeats.
"""

from typing import Final, TypeAlias

import msgspec

LARGEST_FRAME: Final = 1024
"""Bytes of a frame from a page; the connection of who sends more is closed."""


class _Frame(msgspec.Struct, tag_field="do", forbid_unknown_fields=True, frozen=True):
    n: int


class Hello(_Frame, tag="hello", frozen=True):
    """The first frame of a page that may do more than look."""

    token: str


class Alive(_Frame, tag="alive", frozen=True):
    """The page is open; while it calibrates, its silence stops the robot."""


class Select(_Frame, tag="select", frozen=True):
    """Take a tool in hand, or none."""

    tool: str | None


class Enable(_Frame, tag="enable", frozen=True):
    """Compensation on or off."""

    on: bool


class Tare(_Frame, tag="tare", frozen=True):
    """Take what is left of the wrench off."""


class Untare(_Frame, tag="untare", frozen=True):
    """Take the tare back."""


class Zero(_Frame, tag="zero", frozen=True):
    """Zero the sensor, with no tool on."""


class Stop(_Frame, tag="stop", frozen=True):
    """Bring everything to rest."""


class Motors(_Frame, tag="motors", frozen=True):
    """Switch the motors on, or let them move again after a stop."""


class Calibrate(_Frame, tag="calibrate", frozen=True):
    """Begin to calibrate a tool."""

    tool: str


class GoOn(_Frame, tag="go_on", frozen=True):
    """What was asked for is done: the tool is off, or on."""


class Abort(_Frame, tag="abort", frozen=True):
    """End the calibration."""


class Decide(_Frame, tag="decide", frozen=True):
    """Use what was found from now on, or not."""

    accept: bool


Frame: TypeAlias = (
    Hello | Alive | Select | Enable | Tare | Untare | Zero | Stop | Motors | Calibrate | GoOn | Abort | Decide
)
_DECODER: Final[msgspec.json.Decoder[Frame]] = msgspec.json.Decoder(Frame)


class FrameError(ValueError):
    """What a page sent is no frame."""


def read_frame(text: str) -> Frame:
    """The frame that a text holds.

    Raises:
        FrameError: none, or too large.
    """
    if len(text.encode(errors="replace")) > LARGEST_FRAME:
        raise FrameError(f"more than {LARGEST_FRAME} bytes")
    try:
        return _DECODER.decode(text)
    except (ValueError, RecursionError) as error:  # msgspec.DecodeError and UnicodeError are ValueErrors
        raise FrameError(str(error)) from None
