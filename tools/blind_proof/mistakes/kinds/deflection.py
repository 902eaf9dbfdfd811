"""Mistakes in sets for `deflection fit`: the tracker's, the joints' and the push's."""

from galen_hw.tools.blind_proof.mistakes.kinds import cells, clocks, frames, units
from galen_hw.tools.blind_proof.mistakes.kinds.kind import Apply, Kind, Made, Rng
from galen_hw.tools.blind_proof.mistakes.recording import Recording

APPLIED = tuple(f"applied.force.{a}" for a in "xyz")
PUSHED = ("pushed",)


def push_reversed(rec: Recording, rng: Rng) -> Made:
    """The push with the other sign: what the tip does to the hand."""
    del rng
    rec.put(APPLIED, -rec.get(APPLIED))
    return Made("the push with the other sign")


def _kind(of: str, about: str, apply: Apply, named: tuple[str, ...], *, silent: bool = False) -> Kind:
    return Kind(f"deflection_{of}", about, "deflection", PUSHED, apply, named, silent=silent)


KINDS = (
    _kind("pose_unit", units.ABOUT, units.pose_in_mm, (units.UNIT + r"|\bmm\b|\bcm\b|inch",)),
    _kind("degrees", units.ABOUT, units.joints_in_degrees, (units.DEGREES,)),
    _kind("bad_float", cells.ABOUT, cells.ndi_bad_float, (cells.LOST + "|e28|NDI",)),
    _kind("zeros", cells.ABOUT, cells.lost_zeros, (cells.LOST + "|zero",)),
    _kind("stamps", clocks.ABOUT, clocks.stamps_unit, (clocks.CLOCK,), silent=True),
    _kind("left_handed", frames.ABOUT, frames.tracker_left_handed, (frames.MIRROR,)),
    _kind("y_up", frames.ABOUT, frames.tracker_y_up, (frames.TRACKER,), silent=True),
    _kind("push_reversed", frames.ABOUT, push_reversed, (frames.SIGN,)),
)
