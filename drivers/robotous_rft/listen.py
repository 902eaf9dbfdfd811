"""A Robotous RFT sensor in a log of its bus: the codec's responses and the pairer's pairs, with nobody asking."""

from typing import Any, Final

import numpy as np

from galen_hw.drivers.device import CanFrame
from galen_hw.drivers.listening import Frames, Heard, is_first, most_heard, paired
from galen_hw.drivers.pairing import PairLayout
from galen_hw.drivers.robotous_rft import codec
from galen_hw.drivers.robotous_rft.codec import DATA, LENGTH, MODELS, OVERLOAD_MASK, Command
from galen_hw.errors import UsageError

KEYS: Final = ("transmitter1_id", "transmitter2_id", "model", "counts_per_newton", "counts_per_newton_metre")


def recognises(frames: Frames, settings: dict[str, Any]) -> int:
    """How many samples of such a sensor a log may hold."""
    layout = _layout(frames, settings)
    return 0 if layout is None else sum(is_first(frame, layout) for frame, _ in frames)


def listen(frames: Frames, settings: dict[str, Any]) -> Heard:
    """The samples.

    Args:
        frames: of the log, in order.
        settings: transmitter1_id, transmitter2_id, else those that are heard; model, or counts_per_newton and _metre, else the
            model that the log names.

    Raises:
        UsageError: no stream is in it, or its scaling is not known.
    """
    layout = _layout(frames, settings)
    if layout is None:
        raise UsageError("no stream of a Robotous sensor is in it", todo="are its identifiers right?")
    texts = {number: _answer(frames, layout, number) for number in (Command.READ_MODEL, Command.READ_SERIAL_NUMBER)}
    newton, newton_metre, said = _scaling(settings, texts[Command.READ_MODEL])
    responses, lost = paired(frames, layout)
    values = np.array([DATA.unpack(data) for data, _ in responses], dtype=float).reshape(-1, 7)
    wrench = values[:, :6] / np.array([newton] * 3 + [newton_metre] * 3)
    over = (values[:, 6].astype(int) & OVERLOAD_MASK) != 0
    wrench[over] = np.nan
    lost["overloaded (left empty)"] = int(over.sum())
    t_ns = np.array([t for _, t in responses], dtype=np.int64)
    return Heard(t_ns, wrench, texts[Command.READ_SERIAL_NUMBER], said, lost)


def _layout(frames: Frames, settings: dict[str, Any]) -> PairLayout | None:
    """By the identifiers given, or those of most responses of the stream whose second frame comes next."""
    given = settings.get("transmitter1_id"), settings.get("transmitter2_id")
    ids = given if isinstance(given[0], int) and isinstance(given[1], int) else most_heard(frames, _response)
    return None if ids is None else codec.layout(*ids)


def _response(first: CanFrame, second: CanFrame) -> tuple[int, int] | None:
    """The identifiers of two frames that may be a response of the stream."""
    streamed = first.data[:1] == bytes([Command.START_OUTPUT]) and first.data[1:] != bytes(LENGTH - 1)
    whole = len(first.data) == LENGTH == len(second.data)
    return (first.arbitration_id, second.arbitration_id) if streamed and whole else None


def _answer(frames: Frames, layout: PairLayout, number: int) -> str:
    """The text that answers a command; empty where it is not in the log."""
    first = b""
    for frame, _ in frames:
        if frame.arbitration_id == layout.first_id:
            first = frame.data if frame.data[:1] == bytes([number]) and len(frame.data) == LENGTH else b""
        elif frame.arbitration_id == layout.second_id and first and len(frame.data) == LENGTH:
            return codec.decode_text(first + frame.data)
    return ""


def _scaling(settings: dict[str, Any], heard: str) -> tuple[float, float, str]:
    name = str(settings.get("model") or heard)
    known = MODELS.get(name)
    newton = settings.get("counts_per_newton") or (known and known.counts_per_newton)
    newton_metre = settings.get("counts_per_newton_metre") or (known and known.counts_per_newton_metre)
    if not newton or not newton_metre:
        what = f"the log names {'no model' if not name else f'the model {name!r}, which is not known'}: the scaling is not known"
        raise UsageError(
            what, todo="give can.model, or can.counts_per_newton and can.counts_per_newton_metre, in a map"
        )
    return (
        float(newton),
        float(newton_metre),
        f"{name or 'scaling of the map'}: {newton} counts/N, {newton_metre} counts/N m",
    )
