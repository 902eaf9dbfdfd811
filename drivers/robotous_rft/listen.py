"""A Robotous RFT sensor in a log of its bus: the codec's responses and the pairer's pairs, with nobody asking."""

from collections import Counter
from itertools import pairwise
from typing import Any, Final

import numpy as np

from galen_hw.drivers.listening import Frames, Heard
from galen_hw.drivers.robotous_rft import codec
from galen_hw.drivers.robotous_rft.codec import DATA, LENGTH, MODELS, OVERLOAD_MASK, Command
from galen_hw.drivers.robotous_rft.stream import pairer
from galen_hw.errors import UsageError

KEYS: Final = ("transmitter1_id", "transmitter2_id", "model", "counts_per_newton", "counts_per_newton_metre")
WINDOW_NS: Final = 5_000_000
Response = tuple[bytes, int]


def recognises(frames: Frames, settings: dict[str, Any]) -> int:
    """How many samples of such a sensor a log may hold."""
    ids = _ids(frames, settings)
    return 0 if ids is None else sum(f.arbitration_id == ids[0] and f.data[:1] == _NUMBER for f, _ in frames)


_NUMBER: Final = bytes([Command.START_OUTPUT])


def listen(frames: Frames, settings: dict[str, Any]) -> Heard:
    """The samples.

    Args:
        frames: of the log, in order.
        settings: transmitter1_id, transmitter2_id, else those that are heard; model, or counts_per_newton and _metre, else the
            model that the log names.

    Raises:
        UsageError: no stream is in it, or its scaling is not known.
    """
    ids = _ids(frames, settings)
    if ids is None:
        raise UsageError("no stream of a Robotous sensor is in it", todo="are its identifiers right?")
    texts = {number: _answer(frames, ids, number) for number in (Command.READ_MODEL, Command.READ_SERIAL_NUMBER)}
    newton, newton_metre, said = _scaling(settings, texts[Command.READ_MODEL])
    responses, lost = _responses(frames, ids)
    values = np.array([DATA.unpack(data) for data, _ in responses], dtype=float).reshape(-1, 7)
    wrench = values[:, :6] / np.array([newton] * 3 + [newton_metre] * 3)
    over = (values[:, 6].astype(int) & OVERLOAD_MASK) != 0
    wrench[over] = np.nan
    lost["overloaded (left empty)"] = int(over.sum())
    t_ns = np.array([t for _, t in responses], dtype=np.int64)
    return Heard(t_ns, wrench, texts[Command.READ_SERIAL_NUMBER], said, lost)


def _ids(frames: Frames, settings: dict[str, Any]) -> tuple[int, int] | None:
    """The identifiers given, or those of most responses of the stream whose second frame comes next."""
    given = settings.get("transmitter1_id"), settings.get("transmitter2_id")
    if isinstance(given[0], int) and isinstance(given[1], int):
        return given[0], given[1]
    seen: Counter[tuple[int, int]] = Counter()
    for (first, _), (second, _) in pairwise(frames):
        if first.data[:1] == _NUMBER and len(first.data) == LENGTH == len(second.data) and first.data[1:] != bytes(7):
            seen[first.arbitration_id, second.arbitration_id] += 1
    return seen.most_common(1)[0][0] if seen else None


def _responses(frames: Frames, ids: tuple[int, int]) -> tuple[list[Response], dict[str, int]]:
    times = np.array([t for f, t in frames if f.arbitration_id == ids[0] and f.data[:1] == _NUMBER], dtype=np.int64)
    period_ns = int(np.median(np.diff(times))) if len(times) > 1 else WINDOW_NS
    counters = dict.fromkeys(("lost", "late", "doubled", "short"), 0)
    pairs = pairer(max(1, period_ns), max(1, min(WINDOW_NS, period_ns // 2)), 2**62, counters)
    out = []
    for frame, t_ns in frames:
        if frame.arbitration_id == ids[0]:
            pairs.first(frame.data, t_ns)
        elif frame.arbitration_id == ids[1] and (found := pairs.second(frame.data, t_ns)) is not None:
            out.append((found, t_ns))
    return out, {
        "a sample of which one frame is missing": counters["lost"],
        "a frame that came twice": counters["doubled"],
    }


def _answer(frames: Frames, ids: tuple[int, int], number: int) -> str:
    """The text that answers a command; empty where it is not in the log."""
    first = b""
    for frame, _ in frames:
        if frame.arbitration_id == ids[0]:
            first = frame.data if frame.data[:1] == bytes([number]) and len(frame.data) == LENGTH else b""
        elif frame.arbitration_id == ids[1] and first and len(frame.data) == LENGTH:
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
